//! The user's end.

use super::{ALIVE, Frame, GONE, INTERVAL, read, socket, write};
use crate::failure::Failure;
use crate::process::signals::Ending;
use plumbline_ipc::{
    FeedForwardMessage, GuestDelivery, GuestReceiver, Response, RobotId, Server, ServerSettings, boot_ns, now_ns,
};
use std::io;
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

/// No sample passes the relay: none is retained.
const SETTINGS: ServerSettings = ServerSettings { retain: 1, silent_ms: 1000 };
/// Pause between two attempts to connect.
const RETRY: Duration = Duration::from_millis(500);

/// Serves what the relay in `folder` sends to the clients of this user, until a signal ends it. A relay or daemon that has ended is waited for.
///
/// # Errors
/// A folder that can't be used; a socket that this user may not open.
pub fn join(robot: &RobotId, folder: &Path) -> Result<(), Failure> {
    let path = socket(folder, robot)?;
    let ending = Ending::interrupts()?;
    let mut told = String::new();
    while !ending.arrived() {
        let reason = match UnixStream::connect(&path) {
            Ok(stream) => connected(robot, &stream, &ending),
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
                let text = "this user is not in the group that may open it";
                return Err(Failure::job(format!("{}: {error}: {text}", path.display())));
            }
            Err(error) => error.to_string(),
        };
        if reason != told && !ending.arrived() {
            tracing::warn!("{}: {reason}; trying again", path.display());
            told = reason;
        }
        std::thread::sleep(RETRY);
    }
    Ok(())
}

/// Serves until the connection ends; the reason. The user's clients see the end of the server as the end of the daemon.
fn connected(robot: &RobotId, stream: &UnixStream, ending: &Ending) -> String {
    let prepared = stream.set_write_timeout(Some(GONE)).and_then(|()| stream.set_read_timeout(Some(GONE)));
    if let Err(error) = prepared {
        return error.to_string();
    }
    let (give, frames) = channel();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let mut from = stream;
            loop {
                let frame = read(&mut from);
                let ended = frame.is_err();
                if give.send(frame).is_err() || ended {
                    return;
                }
            }
        });
        let reason = relay(robot, stream, &frames, ending);
        let _ = stream.shutdown(Shutdown::Both);
        reason
    })
}

fn relay(robot: &RobotId, mut stream: &UnixStream, frames: &Receiver<io::Result<Frame>>, ending: &Ending) -> String {
    let opened = Server::open(robot, SETTINGS).and_then(|server| Ok((server, GuestReceiver::open(robot)?)));
    let (mut server, mut guest) = match opened {
        Ok(opened) => opened,
        Err(error) => return error.to_string(),
    };
    let mut alive = Instant::now();
    while !ending.arrived() {
        loop {
            match frames.try_recv() {
                Ok(Ok(Frame::Torque(message))) => server.feed_forward(on_monotonic_clock(message)),
                Ok(Ok(Frame::Model { header, text })) => server.model(header, &text),
                Ok(Ok(Frame::Alive)) => {}
                Ok(Ok(Frame::Refused(reason))) => return reason,
                Ok(Ok(Frame::States(_))) => return "the relay sent states".into(),
                Ok(Err(error)) => return error.to_string(),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => return "the connection has ended".into(),
            }
        }
        server.poll(|_, _| Response::Refused {
            reason: "a relay passes no requests: only the daemon's user commands the arm".into(),
        });
        let deliveries = match guest.receive() {
            Ok(deliveries) => deliveries,
            Err(error) => return error.to_string(),
        };
        for delivery in deliveries {
            if let GuestDelivery::Samples(samples) = delivery
                && let Err(error) = write(&mut stream, &Frame::States(samples))
            {
                return error.to_string();
            }
        }
        if alive.elapsed() > ALIVE {
            alive = Instant::now();
            if let Err(error) = write(&mut stream, &Frame::Alive) {
                return error.to_string();
            }
        }
        std::thread::sleep(INTERVAL);
    }
    "a signal".into()
}

/// The message with its stamp on `CLOCK_MONOTONIC`, as [`Server::feed_forward`] takes it.
fn on_monotonic_clock(message: FeedForwardMessage) -> FeedForwardMessage {
    let suspended = boot_ns().saturating_sub(now_ns());
    FeedForwardMessage { stamp_ns: message.stamp_ns.saturating_sub(suspended), ..message }
}
