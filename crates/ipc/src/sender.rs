//! Sender of a request, by the transport and the kernel.

use std::fmt;
use std::fs;

use iceoryx2::identifiers::UniqueClientId;
use iceoryx2::prelude::*;

use super::services;

/// Process of a client's port, by the identity of its iceoryx2 node. The client writes that identity, so a process of the daemon's user
/// can forge it; processes of other users have no port.
pub(super) struct Sender {
    process: Option<u32>,
}

impl Sender {
    pub(super) fn of(service: &services::Commands, client: UniqueClientId) -> Sender {
        let mut process = None;
        service.dynamic_config().list_clients(|details| {
            if details.client_id == client {
                let pid = details.node_id.pid::<ipc::Service>().ok();
                process = pid.and_then(|pid| u32::try_from(pid.value()).ok());
                return CallbackProgression::Stop;
            }
            CallbackProgression::Continue
        });
        Sender { process }
    }
}

impl fmt::Display for Sender {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(process) = self.process else { return f.write_str("a process that has ended") };
        write!(f, "process {process}")?;
        let read = |file: &str| fs::read_to_string(format!("/proc/{process}/{file}")).unwrap_or_default();
        let status = read("status");
        let field = |name: &str| status.lines().find_map(|line| line.strip_prefix(name)?.split_whitespace().next());
        if let (Some(name), Some(user)) = (field("Name:"), field("Uid:")) {
            write!(f, " ({name}) of user {user}")?;
            // Login user, unchanged by `sudo`; 2^32 - 1 for none.
            let login = read("loginuid").trim().parse::<u32>().ok().filter(|&login| login != u32::MAX);
            if let Some(login) = login.filter(|login| login.to_string() != user) {
                write!(f, ", logged in as user {login}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sender_is_described_by_process_program_and_user() {
        let own = Sender { process: Some(std::process::id()) }.to_string();
        let user = rustix::process::getuid().as_raw();
        assert!(own.starts_with(&format!("process {} (", std::process::id())), "{own}");
        assert!(own.contains(&format!(") of user {user}")), "{own}");
        assert_eq!(Sender { process: None }.to_string(), "a process that has ended");
    }
}
