//! Metrics endpoint: the figures of the live view for Prometheus, over HTTP on the loopback interface.
//!
//! Its thread has no real-time priority and is a client of the daemon like any other: nothing in the loop or the bridge thread is done for it.

use crate::config::job::Job;
use crate::monitor::{Monitor, exposition};
use plumbline_core::BadInput;
use plumbline_ipc::{RobotId, boot_ns};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Interval at which samples and connections are read.
const INTERVAL: Duration = Duration::from_millis(20);
/// Interval of the attempts to reach the daemon while it does not respond.
const RETRY: Duration = Duration::from_millis(500);
/// Time that a client has for its request, and for reading the response.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(2);
const RESPONSE_TIMEOUT: Duration = Duration::from_millis(200);
/// Maximum connections at a time; further ones wait in the socket's queue.
const MAX_CONNECTIONS: usize = 16;
/// Maximum length of a request \[bytes\].
const MAX_REQUEST_BYTES: usize = 4096;

/// The socket of the endpoint; `None` where the job has none.
///
/// # Errors
/// A port that is taken or not permitted, by key.
pub fn bind(job: &Job) -> Result<Option<TcpListener>, BadInput> {
    let Some(port) = job.serve.metrics_port else { return Ok(None) };
    // The job's check has its range.
    let address = (Ipv4Addr::LOCALHOST, u16::try_from(port).unwrap_or_default());
    let listener = TcpListener::bind(address).and_then(|listener| {
        listener.set_nonblocking(true)?;
        Ok(listener)
    });
    listener.map(Some).map_err(|error| {
        let found = match error.kind() {
            ErrorKind::AddrInUse => format!("{port}, which another program listens on"),
            _ => format!("{port}: {error}"),
        };
        BadInput::new(
            job.file.display().to_string(),
            "key `serve.metrics-port`",
            found,
            "a free TCP port of 127.0.0.1, one per daemon",
        )
    })
}

/// The running endpoint; it ends when dropped.
pub struct Metrics {
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Metrics {
    /// Starts the thread. Call it before the priority of the calling thread goes up, which the new one would inherit.
    ///
    /// # Errors
    /// The system has no thread left.
    pub fn start(listener: TcpListener, id: &RobotId) -> io::Result<Metrics> {
        let end = Arc::new(AtomicBool::new(false));
        let (ended, id) = (Arc::clone(&end), id.clone());
        if let Ok(address) = listener.local_addr() {
            tracing::info!("metrics are served at http://{address}/metrics");
        }
        let thread = std::thread::Builder::new().name("metrics".into()).spawn(move || serve(&listener, id, &ended))?;
        Ok(Metrics { end, thread: Some(thread) })
    }
}

impl Drop for Metrics {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        // Its panic is no reason to end otherwise.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn serve(listener: &TcpListener, id: RobotId, end: &AtomicBool) {
    let mut monitor = Monitor::new(id);
    let mut connected = false;
    let mut tried: Option<Instant> = None;
    let mut open: Vec<Connection> = Vec::new();
    while !end.load(Ordering::Relaxed) {
        // Samples are counted from the daemon's start on, not from the first scrape.
        if !connected && tried.is_none_or(|tried| tried.elapsed() > RETRY) {
            connected = monitor.query();
            tried = Some(Instant::now());
        }
        monitor.read();
        while open.len() < MAX_CONNECTIONS
            && let Ok((stream, _)) = listener.accept()
        {
            open.extend(Connection::new(stream).ok());
        }
        open.retain_mut(|connection| match connection.poll() {
            Reading::Pending => true,
            Reading::Ended => false,
            Reading::Request => {
                let response = respond(&connection.request, || {
                    connected = monitor.query();
                    exposition(&monitor.watched, monitor.id().as_str(), boot_ns()).filter(|_| connected)
                });
                connection.answer(&response);
                false
            }
        });
        std::thread::sleep(INTERVAL);
    }
}

/// A client with what it has sent.
struct Connection {
    stream: TcpStream,
    request: Vec<u8>,
    due: Instant,
}

enum Reading {
    Pending,
    /// The head of a request is complete, or longer than any that is answered.
    Request,
    /// The client has gone, or has not sent a request in time.
    Ended,
}

impl Connection {
    fn new(stream: TcpStream) -> io::Result<Connection> {
        stream.set_nonblocking(true)?;
        Ok(Connection { stream, request: Vec::new(), due: Instant::now() + REQUEST_TIMEOUT })
    }

    /// Reads what has arrived.
    fn poll(&mut self) -> Reading {
        let mut bytes = [0; 1024];
        loop {
            match self.stream.read(&mut bytes) {
                Ok(0) => return Reading::Ended,
                Ok(count) => self.request.extend_from_slice(&bytes[..count]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    return if Instant::now() > self.due { Reading::Ended } else { Reading::Pending };
                }
                Err(_) => return Reading::Ended,
            }
            if self.request.len() > MAX_REQUEST_BYTES || self.request.windows(4).any(|end| end == b"\r\n\r\n") {
                return Reading::Request;
            }
        }
    }

    /// Sends a response. One that a client does not read in time is cut off.
    fn answer(&mut self, response: &str) {
        let sent = self.stream.set_nonblocking(false).and_then(|()| {
            self.stream.set_write_timeout(Some(RESPONSE_TIMEOUT))?;
            self.stream.write_all(response.as_bytes())
        });
        if let Err(error) = sent {
            tracing::debug!("metrics: {error}");
        }
    }
}

/// Response to the head of a request; `page` is the text at `/metrics`, `None` while the daemon does not respond.
fn respond(request: &[u8], page: impl FnOnce() -> Option<String>) -> String {
    let head = std::str::from_utf8(request).unwrap_or_default();
    let words: Vec<&str> = head.lines().next().unwrap_or_default().split(' ').collect();
    let (status, body) = match words[..] {
        _ if request.len() > MAX_REQUEST_BYTES => {
            ("431 Request Header Fields Too Large", "the request is too long\n".into())
        }
        ["GET", path, version] if version.starts_with("HTTP/1.") => match path.split('?').next() {
            Some("/metrics") => match page() {
                Some(text) => ("200 OK", text),
                None => ("503 Service Unavailable", "the daemon does not respond\n".into()),
            },
            _ => ("404 Not Found", "the metrics are at /metrics\n".into()),
        },
        [_, _, version] if version.starts_with("HTTP/1.") => {
            ("405 Method Not Allowed", "only GET is answered\n".into())
        }
        _ => ("400 Bad Request", "no HTTP/1 request\n".into()),
    };
    let length = body.len();
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; version=0.0.4; charset=utf-8\r\nContent-Length: {length}\r\n\
         Connection: close\r\n\r\n{body}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_get_of_the_page_is_answered_with_it() {
        let status = |request: &[u8], page: Option<&str>| {
            let response = respond(request, || page.map(str::to_string));
            let (head, body) = response.split_once("\r\n\r\n").unwrap();
            assert!(head.contains(&format!("Content-Length: {}", body.len())), "{response}");
            head.split(' ').nth(1).unwrap().parse::<u16>().unwrap()
        };
        assert_eq!(status(b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n", Some("a 1\n")), 200);
        assert_eq!(status(b"GET /metrics?x=1 HTTP/1.0\r\n\r\n", Some("a 1\n")), 200);
        assert_eq!(status(b"GET /metrics HTTP/1.1\r\n\r\n", None), 503);
        assert_eq!(status(b"GET / HTTP/1.1\r\n\r\n", Some("")), 404);
        assert_eq!(status(b"POST /metrics HTTP/1.1\r\n\r\n", Some("")), 405);
        for garbage in [&b"\r\n\r\n"[..], b"\xff\xfe\r\n\r\n", b"GET /metrics\r\n\r\n", b"GET /metrics HTTP/2\r\n\r\n"]
        {
            assert_eq!(status(garbage, Some("")), 400, "{garbage:?}");
        }
        assert_eq!(status(&vec![b'a'; MAX_REQUEST_BYTES + 1], Some("")), 431);
    }
}
