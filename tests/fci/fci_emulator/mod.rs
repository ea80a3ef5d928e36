//! The emulator of Franka's control interface against a scripted client: it gives what a robot gives and refuses what a robot
//! refuses, by name. Clients of other origin are in `hil/fci-peers`.

mod client;

mod faults;
mod limits;
mod motions;
mod program;
mod requests;

use client::Client;
use plumbline_franka::wire::Protocol;
use plumbline_testkit::emulator::{self, Emulator, Settings, address};
use std::time::Duration;

/// A robot whose time waits for the client: a machine that stalls must not decide these tests.
fn waiting(protocol: Protocol) -> Settings {
    Settings { command_wait: Duration::from_secs(2), ..Settings::new(address(), protocol) }
}

fn session(settings: Settings) -> (Emulator, Client) {
    let (address, protocol) = (settings.address, settings.protocol);
    let emulator = Emulator::start(settings).unwrap_or_else(|error| panic!("{error}"));
    (emulator, Client::connect(address, protocol))
}

/// The same test at every version, at once: a motion takes its time.
fn each_protocol(test: impl Fn(Protocol) + Sync) {
    std::thread::scope(|scope| {
        for protocol in Protocol::ALL {
            let test = &test;
            scope.spawn(move || test(protocol));
        }
    });
}
