//! The daemon's end.

use super::{ALIVE, Frame, GONE, INTERVAL, read, socket, write};
use crate::failure::Failure;
use crate::process::signals::Ending;
use plumbline_ipc::{FeedForwardClient, FeedForwardSettings, GuestPublisher, IpcError, ModelClient, Presence, RobotId};
use std::fs::{self, Permissions};
use std::io;
use std::net::Shutdown;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Connections at a time.
const MAX_CONNECTIONS: usize = 8;

/// Serves the daemon of `robot` to the group of the socket in `folder`, until a signal ends it.
///
/// # Errors
/// A folder that can't be used, or a socket that can't be made.
pub fn serve(robot: &RobotId, folder: &Path) -> Result<(), Failure> {
    let path = socket(folder, robot)?;
    let failed = |error: io::Error| Failure::job(format!("{}: {error}", path.display()));
    let ending = Ending::interrupts()?;
    // A socket that answers belongs to another relay.
    if UnixStream::connect(&path).is_ok() {
        return Err(Failure::job(format!("{}: another relay serves this robot", path.display())));
    }
    crate::atomic::remove_file(&path).map_err(failed)?;
    let listener = UnixListener::bind(&path).map_err(failed)?;
    fs::set_permissions(&path, Permissions::from_mode(0o660)).map_err(failed)?;
    listener.set_nonblocking(true).map_err(failed)?;
    tracing::info!("robot `{robot}` is served at {}", path.display());
    let connections = Arc::new(AtomicUsize::new(0));
    while !ending.arrived() {
        match listener.accept() {
            Ok((stream, _)) => {
                let (robot, connections) = (robot.clone(), Arc::clone(&connections));
                let place = Place::take(connections);
                let spawned = std::thread::Builder::new().name("plumbline-relay".into()).spawn(move || {
                    let reason = match place {
                        Some(_place) => connected(&robot, &stream),
                        None => format!("{MAX_CONNECTIONS} users are connected already"),
                    };
                    tracing::info!("a connection has ended: {reason}");
                    let _ = write(&mut &stream, &Frame::Refused(reason));
                    let _ = stream.shutdown(Shutdown::Both);
                });
                if let Err(error) = spawned {
                    tracing::warn!("no thread for a connection: {error}");
                }
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => std::thread::sleep(Duration::from_millis(5)),
            Err(error) => tracing::warn!("a connection failed: {error}"),
        }
    }
    crate::atomic::remove_file(&path).map_err(failed)
}

/// One of the places for connections.
struct Place(Arc<AtomicUsize>);

impl Place {
    fn take(connections: Arc<AtomicUsize>) -> Option<Place> {
        let taken = connections.fetch_add(1, Ordering::SeqCst) < MAX_CONNECTIONS;
        let place = Place(connections);
        taken.then_some(place)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Sends until the connection or the daemon ends; the reason.
fn connected(robot: &RobotId, stream: &UnixStream) -> String {
    let prepared = stream.set_nonblocking(false).and_then(|()| stream.set_write_timeout(Some(GONE)));
    let prepared = prepared.and_then(|()| stream.set_read_timeout(Some(GONE)));
    if let Err(error) = prepared {
        return error.to_string();
    }
    std::thread::scope(|scope| {
        let states = scope.spawn(|| {
            let reason = publish(robot, stream);
            // The sending side ends at its next frame.
            let _ = stream.shutdown(Shutdown::Read);
            reason
        });
        let sent = send(robot, stream, &|| states.is_finished());
        let _ = stream.shutdown(Shutdown::Read);
        let received = states.join().unwrap_or_else(|_| "the receiving thread panicked".into());
        sent.map_or_else(|error| error.to_string(), |()| received)
    })
}

/// Sends torque and model until the daemon, the user or the receiving side has ended.
fn send(robot: &RobotId, mut stream: &UnixStream, ended: &dyn Fn() -> bool) -> Result<(), io::Error> {
    let other = |error: IpcError| io::Error::other(error);
    let mut torque = FeedForwardClient::connect(robot, FeedForwardSettings::default(), GONE).map_err(other)?;
    let mut model = ModelClient::connect(robot, GONE).map_err(other)?;
    let (mut sent, mut looked) = (None, Instant::now());
    while !ended() {
        if let Some(message) = model.receive().map_err(other)? {
            write(&mut stream, &Frame::Model { header: message.header, text: message.text })?;
        }
        if let Some(latest) = torque.latest().map_err(other)? {
            let number = (latest.message.epoch, latest.message.sequence);
            if sent != Some(number) {
                write(&mut stream, &Frame::Torque(latest.message))?;
                sent = Some(number);
            }
        }
        if looked.elapsed() > ALIVE {
            looked = Instant::now();
            if torque.daemon() == Presence::Gone {
                return Err(io::Error::other(format!("the daemon of robot `{robot}` has ended")));
            }
            write(&mut stream, &Frame::Alive)?;
        }
        std::thread::sleep(INTERVAL);
    }
    Ok(())
}

/// Publishes the states that arrive; why it ended.
fn publish(robot: &RobotId, mut stream: &UnixStream) -> String {
    let mut publisher: Option<(u64, GuestPublisher)> = None;
    loop {
        let samples = match read(&mut stream) {
            Ok(Frame::States(samples)) => samples,
            Ok(Frame::Alive) => continue,
            Ok(_) => return "the user sent what is no state".into(),
            Err(error) => return error.to_string(),
        };
        let Some(epoch) = samples.first().map(|sample| sample.epoch) else { continue };
        // The service has one publisher, which the first state takes. Numbers start again with the user's next publisher, and with one here.
        if publisher.as_ref().is_none_or(|(of, _)| *of != epoch) {
            drop(publisher.take());
            match GuestPublisher::open(robot) {
                Ok(opened) => publisher = Some((epoch, opened)),
                Err(error) => return error.to_string(),
            }
        }
        if let Some(Err(error)) = publisher.as_mut().map(|(_, publisher)| publisher.send(&samples)) {
            return error.to_string();
        }
    }
}
