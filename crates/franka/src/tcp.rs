//! The command connection: one request and its answer at connection, nonblocking reads while a motion runs.

use super::error::ConnectError;
use super::wire::{
    CommandKind, HEADER_BYTES, Header, MAX_MESSAGE, MAX_REQUEST, MoveStatus, Protocol, Request, Response,
};
use rustix::net::{RecvFlags, SendFlags};
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

/// Bytes of a message that are read while a motion runs: all answers of that time are shorter.
const MAX_READ_BYTES: usize = 64;

/// A connection and the numbers of its calls.
#[derive(Debug)]
pub(super) struct CommandLink {
    stream: TcpStream,
    next_id: u32,
    /// Front of the message that is arriving.
    message: [u8; MAX_READ_BYTES],
    filled: usize,
    /// Bytes still to come of a longer message, which are skipped.
    skip: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ConnectionLost {
    /// The arm or the network has closed it.
    Closed,
    /// The bytes received are no message of the protocol; it began with these.
    Garbled([u8; HEADER_BYTES]),
}

impl CommandLink {
    pub fn new(stream: TcpStream) -> CommandLink {
        CommandLink { stream, next_id: 0, message: [0; MAX_READ_BYTES], filled: 0, skip: 0 }
    }

    fn take_id(&mut self) -> u32 {
        let id = self.next_id;
        self.next_id = id.wrapping_add(1);
        id
    }

    /// Sends `request` and waits for its answer's payload; `protocol` is the one the numbers of commands go by.
    pub fn call(&mut self, protocol: Protocol, request: &Request, timeout: Duration) -> Result<Vec<u8>, ConnectError> {
        let command = request.kind();
        let id = self.take_id();
        let mut bytes = [0; MAX_REQUEST];
        let length = request.encode(protocol, id, &mut bytes)?;
        let deadline = Instant::now() + timeout;
        let failed = |error: std::io::Error| match error.kind() {
            ErrorKind::WouldBlock | ErrorKind::TimedOut => ConnectError::NoAnswer { command, waited: timeout },
            _ => ConnectError::Closed { command },
        };
        self.stream.write_all(bytes.get(..length).unwrap_or_default()).map_err(failed)?;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(ConnectError::NoAnswer { command, waited: timeout });
            }
            self.stream.set_read_timeout(Some(left)).map_err(failed)?;
            let mut head = [0; HEADER_BYTES];
            self.stream.read_exact(&mut head).map_err(failed)?;
            let garbled = |_| ConnectError::NoMessage { command, bytes: head };
            let header = Header::decode(&head, MAX_MESSAGE).map_err(garbled)?;
            let mut payload = vec![0; header.payload_bytes()];
            self.stream.read_exact(&mut payload).map_err(failed)?;
            // An answer to an earlier call is skipped.
            if header.command_id == id && Some(header.command) == command.number(protocol) {
                return Ok(payload);
            }
        }
    }

    /// From now on nothing here blocks.
    pub fn into_nonblocking(self) -> std::io::Result<CommandLink> {
        self.stream.set_nonblocking(true)?;
        Ok(self)
    }

    /// Sends a request without waiting; its number is what the answers will carry.
    pub fn post(&mut self, protocol: Protocol, request: &Request) -> Result<u32, ConnectionLost> {
        let id = self.take_id();
        let mut bytes = [0; MAX_REQUEST];
        let length = request.encode(protocol, id, &mut bytes).map_err(|_| ConnectionLost::Closed)?;
        let bytes = bytes.get(..length).ok_or(ConnectionLost::Closed)?;
        let flags = SendFlags::DONTWAIT | SendFlags::NOSIGNAL;
        match rustix::net::send(&self.stream, bytes, flags) {
            Ok(sent) if sent == length => Ok(id),
            // Half a request can't be taken back.
            Ok(_) | Err(_) => Err(ConnectionLost::Closed),
        }
    }

    /// The next answer to the call `id` of Move, if it is there; other answers are passed over.
    pub fn move_answer(&mut self, protocol: Protocol, id: u32) -> Result<Option<MoveStatus>, ConnectionLost> {
        while let Some((header, length)) = self.arrived()? {
            if header.command_id != id || Some(header.command) != CommandKind::Move.number(protocol) {
                continue;
            }
            let payload = self.message.get(HEADER_BYTES..length).ok_or(ConnectionLost::Closed)?;
            match Response::decode(protocol, CommandKind::Move, payload) {
                Ok(Response::Move(status)) => return Ok(Some(status)),
                _ => return Err(self.garbled()),
            }
        }
        Ok(None)
    }

    /// Skips what has arrived, to learn whether the connection is still open.
    pub fn skip_arrived(&mut self) -> Result<(), ConnectionLost> {
        while self.arrived()?.is_some() {}
        Ok(())
    }

    /// Header of the next message that is there in full, and how much of it is in `message`.
    fn arrived(&mut self) -> Result<Option<(Header, usize)>, ConnectionLost> {
        loop {
            if self.skip > 0 {
                let mut rest = [0; 256];
                let most = self.skip.min(rest.len());
                match self.receive_into(rest.get_mut(..most).ok_or(ConnectionLost::Closed)?)? {
                    None => return Ok(None),
                    Some(got) => self.skip -= got.min(self.skip),
                }
                continue;
            }
            let mut wanted = HEADER_BYTES;
            if self.filled >= HEADER_BYTES {
                let header = self.header()?;
                let size = header.size as usize;
                wanted = size.min(MAX_READ_BYTES);
                if self.filled == wanted {
                    self.filled = 0;
                    self.skip = size - wanted;
                    return Ok(Some((header, wanted)));
                }
            }
            let mut bytes = [0; MAX_READ_BYTES];
            let room =
                wanted.checked_sub(self.filled).and_then(|room| bytes.get_mut(..room)).ok_or(ConnectionLost::Closed)?;
            let Some(got) = self.receive_into(room)? else { return Ok(None) };
            let fresh = bytes.get(..got).ok_or(ConnectionLost::Closed)?;
            let place = self.message.get_mut(self.filled..self.filled + got).ok_or(ConnectionLost::Closed)?;
            place.copy_from_slice(fresh);
            self.filled += got;
        }
    }

    fn header(&self) -> Result<Header, ConnectionLost> {
        let head = self.message.first_chunk::<HEADER_BYTES>().ok_or(ConnectionLost::Closed)?;
        Header::decode(head, MAX_MESSAGE).map_err(|_| self.garbled())
    }

    /// The message that is arriving can't be decoded.
    fn garbled(&self) -> ConnectionLost {
        self.message.first_chunk::<HEADER_BYTES>().map_or(ConnectionLost::Closed, |head| ConnectionLost::Garbled(*head))
    }

    /// Bytes that are there now; `None` when there are none.
    fn receive_into(&self, room: &mut [u8]) -> Result<Option<usize>, ConnectionLost> {
        loop {
            return match rustix::net::recv(&self.stream, &mut *room, RecvFlags::DONTWAIT) {
                Ok((0, _)) => Err(ConnectionLost::Closed),
                Ok((got, _)) => Ok(Some(got)),
                Err(rustix::io::Errno::INTR) => continue,
                Err(rustix::io::Errno::AGAIN) => Ok(None),
                Err(_) => Err(ConnectionLost::Closed),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    fn pair() -> (CommandLink, TcpStream) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let client = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        (CommandLink::new(client).into_nonblocking().unwrap(), listener.accept().unwrap().0)
    }

    fn until(link: &mut CommandLink, id: u32) -> Result<MoveStatus, ConnectionLost> {
        let deadline = Instant::now() + Duration::from_secs(2);
        loop {
            match link.move_answer(Protocol::V10, id) {
                Ok(None) if Instant::now() < deadline => std::thread::yield_now(),
                Ok(found) => return Ok(found.expect("an answer in two seconds")),
                Err(gone) => return Err(gone),
            }
        }
    }

    #[test]
    fn answers_are_put_together_from_pieces_and_others_are_passed_over() {
        let (mut link, mut server) = pair();
        assert_eq!(link.move_answer(Protocol::V10, 7), Ok(None));
        let mut bytes = Vec::new();
        let mut add = |id, response: Response| {
            let mut out = vec![0; response.bytes()];
            let length = response.encode(Protocol::V10, id, &mut out).unwrap();
            bytes.extend_from_slice(&out[..length]);
        };
        add(3, Response::Move(MoveStatus::Aborted));
        let urdf = "x".repeat(1000);
        add(7, Response::GetRobotModel { status: super::super::wire::RobotModelStatus::Success, urdf: &urdf });
        add(7, Response::Move(MoveStatus::MotionStarted));
        add(7, Response::Move(MoveStatus::Success));
        let sender = std::thread::spawn(move || {
            for piece in bytes.chunks(5) {
                server.write_all(piece).unwrap();
                server.flush().unwrap();
            }
            server
        });
        assert_eq!(until(&mut link, 7), Ok(MoveStatus::MotionStarted));
        assert_eq!(until(&mut link, 7), Ok(MoveStatus::Success));
        drop(sender.join().unwrap());
        assert_eq!(until(&mut link, 7), Err(ConnectionLost::Closed));
    }

    #[test]
    fn garbage_is_distinguished_from_a_closed_connection_by_its_first_bytes() {
        let (mut link, mut server) = pair();
        server.write_all(b"HTTP/1.1 400 Bad Request").unwrap();
        assert_eq!(until(&mut link, 0), Err(ConnectionLost::Garbled(*b"HTTP/1.1 400")));
        let (mut link, mut server) = pair();
        let header = Header { command: 1, command_id: 0, size: 13 };
        server.write_all(&header.encode()).unwrap();
        server.write_all(&[99]).unwrap();
        assert_eq!(until(&mut link, 0), Err(ConnectionLost::Garbled(header.encode())));
    }
}
