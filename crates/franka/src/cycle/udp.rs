//! States in, commands out.

use crate::wire::{MAX_COMMAND, MAX_STATE, Protocol, RobotCommand, RobotState};
use plumbline_rt::os::{datagram_age_ns, now_ns};
use rustix::net::{RecvFlags, SendFlags};
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::time::Duration;

/// A receive that finds nothing returns after this, so that its caller can check the clock and the other socket.
pub(super) const RECEIVE_TIMEOUT: Duration = Duration::from_millis(10);

#[derive(Debug)]
pub(crate) struct StateLink {
    socket: UdpSocket,
    arm: IpAddr,
    /// Where the last state came from, which is where commands go.
    peer: Option<SocketAddr>,
    other_sender: Option<IpAddr>,
    /// Bytes of the arm's last datagram that was no state.
    damaged: Option<usize>,
    protocol: Protocol,
    /// One byte more than a state, or a longer datagram looks like a good one.
    buffer: [u8; MAX_STATE + 1],
}

/// Result of a receive.
#[derive(Clone, Copy, Debug, PartialEq)]
// It stays on the stack: a box would allocate in the loop.
#[allow(clippy::large_enum_variant)]
pub(crate) enum Received {
    /// A state, and when the kernel took it in, on `CLOCK_MONOTONIC` \[ns\].
    State(RobotState, Option<u64>),
    /// A datagram of the arm that is no state.
    Bad,
    /// A datagram of another sender.
    Foreign,
    /// Nothing.
    Nothing,
    /// The socket is broken.
    Broken,
}

impl StateLink {
    /// Takes states of the arm at `arm` from `socket`, whose receives give up after [`RECEIVE_TIMEOUT`] from now on.
    pub fn new(socket: UdpSocket, arm: IpAddr, protocol: Protocol) -> std::io::Result<StateLink> {
        socket.set_read_timeout(Some(RECEIVE_TIMEOUT))?;
        // The first question switches the kernel's time stamps on.
        datagram_age_ns(&socket);
        Ok(StateLink {
            socket,
            arm,
            peer: None,
            other_sender: None,
            damaged: None,
            protocol,
            buffer: [0; MAX_STATE + 1],
        })
    }

    /// Who else has sent something.
    pub fn other_sender(&self) -> Option<IpAddr> {
        self.other_sender
    }

    /// Bytes of the arm's last datagram that was no state.
    pub fn damaged(&self) -> Option<usize> {
        self.damaged
    }

    /// Whether datagrams from `address` are the arm's. An emulator on this machine may listen at one loopback address and send from another.
    fn is_arm(&self, address: IpAddr) -> bool {
        address == self.arm || (address.is_loopback() && self.arm.is_loopback())
    }

    pub fn protocol(&self) -> Protocol {
        self.protocol
    }

    /// The next datagram; `wait` blocks for up to [`RECEIVE_TIMEOUT`].
    pub fn receive(&mut self, wait: bool) -> Received {
        let flags = if wait { RecvFlags::empty() } else { RecvFlags::DONTWAIT };
        let (length, from) = loop {
            match rustix::net::recvfrom(&self.socket, &mut self.buffer[..], flags) {
                Ok((_, length, from)) => break (length, from),
                Err(rustix::io::Errno::INTR) => continue,
                Err(rustix::io::Errno::AGAIN) => return Received::Nothing,
                // An ICMP message: a command was not delivered. The next states show it.
                Err(rustix::io::Errno::CONNREFUSED | rustix::io::Errno::HOSTUNREACH) => return Received::Nothing,
                Err(_) => return Received::Broken,
            }
        };
        let now = now_ns();
        let from = from.and_then(|from| SocketAddr::try_from(from).ok());
        let Some(from) = from.filter(|from| self.is_arm(from.ip())) else {
            self.other_sender = from.map(|from| from.ip()).or(self.other_sender);
            return Received::Foreign;
        };
        match RobotState::decode(self.protocol, self.buffer.get(..length).unwrap_or_default()) {
            Ok(state) => {
                self.peer = Some(from);
                let at = datagram_age_ns(&self.socket).map(|age| now.saturating_sub(age));
                Received::State(state, at)
            }
            Err(_) => {
                self.damaged = Some(length);
                Received::Bad
            }
        }
    }

    /// Sends a command to where the last state came from; `false` when the system did not take it.
    pub fn send(&self, command: &RobotCommand) -> bool {
        let Some(peer) = self.peer else { return false };
        let mut bytes = [0; MAX_COMMAND];
        let length = command.encode(self.protocol, &mut bytes);
        let Some(bytes) = bytes.get(..length) else { return false };
        rustix::net::sendto(&self.socket, bytes, SendFlags::DONTWAIT | SendFlags::NOSIGNAL, &peer) == Ok(length)
    }
}
