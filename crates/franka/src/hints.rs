//! What to check when no answer comes, by this machine's routing table.

use super::wire::Protocol;
use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr};

/// How this machine reaches an address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Route {
    /// It is this machine itself.
    Loopback,
    /// Through the network of this interface.
    Direct(String),
    /// Through this gateway.
    Gateway(Ipv4Addr, String),
    /// By no route.
    None,
    /// The routes could not be read.
    Unknown,
}

/// The way to `address` by the kernel's table.
pub(super) fn route_to(address: IpAddr) -> Route {
    match (address, std::fs::read_to_string("/proc/net/route")) {
        (address, _) if address.is_loopback() => Route::Loopback,
        (IpAddr::V4(address), Ok(table)) => route_in(&table, address),
        _ => Route::Unknown,
    }
}

/// The way to `address` in the text of `/proc/net/route`: interface, destination, gateway, ..., mask in column 8, each
/// address printed as one number of this machine, whose bytes are in network order.
fn route_in(table: &str, address: Ipv4Addr) -> Route {
    let word = |text: &str| u32::from_str_radix(text, 16).ok().map(|word| u32::from_be_bytes(word.to_ne_bytes()));
    let mut best: Option<(u32, Route)> = None;
    for line in table.lines().skip(1) {
        let columns: Vec<&str> = line.split_whitespace().collect();
        let [interface, destination, gateway, _, _, _, _, mask, ..] = columns[..] else { continue };
        let (Some(destination), Some(gateway), Some(mask)) = (word(destination), word(gateway), word(mask)) else {
            continue;
        };
        let fits = u32::from(address) & mask == destination & mask;
        if fits && best.as_ref().is_none_or(|(longest, _)| mask > *longest) {
            let way = if gateway == 0 {
                Route::Direct(interface.to_string())
            } else {
                Route::Gateway(Ipv4Addr::from(gateway), interface.to_string())
            };
            best = Some((mask, way));
        }
    }
    best.map_or(Route::None, |(_, way)| way)
}

/// What to check when the TCP connection fails with `kind`.
pub(super) fn unreachable(way: &Route, kind: ErrorKind) -> String {
    let subnet = match way {
        Route::Gateway(gateway, interface) => format!(
            "The address is in none of this machine's own subnets: it would be reached through the gateway {gateway} on {interface}. \
             Give the port that the robot is plugged into an address in the robot's subnet (the control unit's LAN port, not \
             the arm's). "
        ),
        Route::None => {
            "This machine has no route to that address: give the port that the robot is plugged into an address in its \
                      subnet (the control unit's LAN port, not the arm's). "
                .to_string()
        }
        Route::Direct(interface) => format!("The address is in the subnet of {interface}. "),
        Route::Loopback | Route::Unknown => String::new(),
    };
    let kind = match kind {
        ErrorKind::ConnectionRefused => {
            "Something is there, but does not listen on port 1337: in Desk, activate FCI, and see that no other user holds control."
        }
        ErrorKind::TimedOut | ErrorKind::WouldBlock => {
            "Nothing answers: is the control unit on, started up, and at this address? Does a firewall drop TCP port 1337?"
        }
        _ => "Is the cable plugged in and the control unit on?",
    };
    subnet + kind
}

/// What to check when datagrams of the arm come, of which the last had so many `bytes`, and none is a state.
pub(super) fn damaged(protocol: Protocol, bytes: usize) -> String {
    format!(
        "Datagrams of the arm did come, but none is a state of {protocol}, which has {} bytes (the last had {bytes}): something on the way \
         changes or cuts them. Look at cable, network card and switch, and connect the robot directly.",
        protocol.state_bytes()
    )
}

/// What to check when the TCP connection is open but no state comes.
pub(super) fn no_states(way: &Route, protocol: Protocol, port: u16, other_sender: Option<IpAddr>) -> String {
    let mut words = other_sender.map_or_else(String::new, |other_sender| {
        format!("Datagrams came from {other_sender} instead: is that the arm, behind an address translation? Use its own address. ")
    });
    words += &match protocol {
        Protocol::V10 => String::new(),
        Protocol::V5 | Protocol::V9 => format!(
            "A state of this version has {} bytes and comes as two fragments: a firewall or switch that drops IP fragments drops every \
             state. ",
            protocol.state_bytes()
        ),
    };
    words += &format!(
        "A firewall on this machine may drop UDP: allow what comes from the robot (now to port {port}, it changes). "
    );
    match way {
        Route::Gateway(gateway, interface) => {
            words += &format!(
                "The robot is not in this machine's subnet but behind {gateway} on {interface}: address translation does not pass its \
                 datagrams. Connect it directly."
            );
        }
        Route::Direct(_) | Route::Loopback | Route::Unknown | Route::None => {
            words += "A second address of this machine in the same subnet may be taken for the sender, too: keep one.";
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Interface, destination, gateway, mask.
    type Row = (&'static str, [u8; 4], [u8; 4], [u8; 4]);

    fn table(rows: &[Row]) -> String {
        let mut text =
            "Iface\tDestination\tGateway \tFlags\tRefCnt\tUse\tMetric\tMask\t\tMTU\tWindow\tIRTT\n".to_string();
        let word = |bytes: [u8; 4]| format!("{:08X}", u32::from_ne_bytes(bytes));
        for (interface, destination, gateway, mask) in rows {
            text += &format!(
                "{interface}\t{}\t{}\t0003\t0\t0\t100\t{}\t0\t0\t0\n",
                word(*destination),
                word(*gateway),
                word(*mask)
            );
        }
        text
    }

    #[test]
    fn the_longest_prefix_decides() {
        let table = table(&[
            ("eth0", [0, 0, 0, 0], [10, 0, 0, 1], [0, 0, 0, 0]),
            ("eth0", [10, 0, 0, 0], [0, 0, 0, 0], [255, 255, 255, 0]),
            ("eth1", [172, 16, 0, 0], [0, 0, 0, 0], [255, 255, 255, 0]),
        ]);
        let way = |text: &str| route_in(&table, text.parse().unwrap());
        assert_eq!(way("172.16.0.2"), Route::Direct("eth1".into()));
        assert_eq!(way("10.0.0.77"), Route::Direct("eth0".into()));
        assert_eq!(way("172.16.1.2"), Route::Gateway(Ipv4Addr::new(10, 0, 0, 1), "eth0".into()));
        assert_eq!(route_in("header\n", "172.16.0.2".parse().unwrap()), Route::None);
    }

    #[test]
    fn every_hint_names_its_cause() {
        let gateway = Route::Gateway(Ipv4Addr::new(10, 0, 0, 1), "eth0".into());
        assert!(unreachable(&gateway, ErrorKind::TimedOut).contains("none of this machine's own subnets"));
        assert!(unreachable(&Route::Direct("eth1".into()), ErrorKind::ConnectionRefused).contains("activate FCI"));
        assert!(no_states(&Route::Loopback, Protocol::V5, 4000, None).contains("fragments"));
        assert!(!no_states(&Route::Loopback, Protocol::V10, 4000, None).contains("fragments"));
        assert!(no_states(&Route::Loopback, Protocol::V10, 4000, None).contains("port 4000"));
        assert!(no_states(&gateway, Protocol::V10, 4000, None).contains("10.0.0.1"));
        let other_sender = Some("10.9.8.7".parse().unwrap());
        assert!(no_states(&Route::Unknown, Protocol::V10, 4000, other_sender).contains("came from 10.9.8.7"));
        assert_eq!(route_to("127.0.0.9".parse().unwrap()), Route::Loopback);
    }
}
