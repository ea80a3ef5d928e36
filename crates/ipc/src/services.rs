//! The iceoryx2 services: their names, sizes, and how they are opened by the daemon and by clients.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;
use std::sync::Once;
use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::identifiers::UniqueNodeId;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::{publish_subscribe as pubsub, request_response as reqres};
use iceoryx2::service::port_factory::{publish_subscribe, request_response};

use super::error::IpcError;
use super::incomplete_segments;
use super::messages::{FeedForwardMessage, FollowRequest, ReplayHeader, SampleMessage};
use super::robot::RobotId;
use super::runtime_dir;

/// Records in one batch of the stream.
pub(super) const BATCH: usize = 32;
/// Records in one answer to a replay request: 304 KiB.
pub(super) const REPLAY: usize = 512;
/// Batches that fit into a follower's buffer.
const STREAM_BUFFER: usize = 256;
/// Followers of the samples.
const MAX_FOLLOWERS: usize = 4;
/// Clients that read the feed-forward.
const MAX_FEED_FORWARD_CLIENTS: usize = 32;
/// Clients of the command service.
pub(super) const MAX_COMMAND_CLIENTS: usize = 16;
/// Those among them that are left to operators.
pub(super) const OPERATORS: usize = 4;
/// Nodes beyond the clients: the daemon, and room for dead ones that nobody has cleaned up yet.
const SPARE_NODES: usize = 16;
/// Pause between two attempts to open something.
const RETRY: Duration = Duration::from_millis(10);

pub(super) type ServiceNode = Node<ipc::Service>;
pub(super) type Samples = publish_subscribe::PortFactory<ipc::Service, [SampleMessage], ()>;
pub(super) type FeedForward = publish_subscribe::PortFactory<ipc::Service, FeedForwardMessage, ()>;
pub(super) type Replay = request_response::PortFactory<ipc::Service, FollowRequest, (), [SampleMessage], ReplayHeader>;
pub(super) type Commands = request_response::PortFactory<ipc::Service, [u8], (), [u8], ()>;

/// `CLOCK_BOOTTIME` \[ns\]: as `CLOCK_MONOTONIC`, and it goes on while the machine is suspended. The clock of what clients reckon ages from.
pub fn boot_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    (now.tv_sec as u64).saturating_mul(1_000_000_000).saturating_add(now.tv_nsec as u64)
}

/// How long the machine has been suspended since it was started \[ns\]; too little by the time between two looks, never too much.
pub(super) fn suspended_ns() -> u64 {
    let boot = boot_ns();
    boot.saturating_sub(now_ns())
}

/// `CLOCK_MONOTONIC` \[ns\], the clock of records and of everything inside the daemon.
pub fn now_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    (now.tv_sec as u64).saturating_mul(1_000_000_000).saturating_add(now.tv_nsec as u64)
}

/// The node of a daemon, which makes the services: nothing is made beside a stranger's files of our names.
pub(super) fn serving_node() -> Result<ServiceNode, IpcError> {
    runtime_dir::no_squatters().map_err(|error| transport("making a node for", "plumbline", error))?;
    node()
}

/// The node of a client. A stranger can lay files of our names beside a daemon that runs; that must not keep anybody from stopping the arm.
pub(super) fn joining_node() -> Result<ServiceNode, IpcError> {
    // Once: a client may connect for every question that it asks.
    static SAID: Once = Once::new();
    if let Err(squatter) = runtime_dir::no_squatters() {
        SAID.call_once(|| {
            tracing::warn!("{squatter}; a daemon that runs is not touched, but the next one will not start")
        });
    }
    node()
}

/// A node of this process; making it removes what killed processes left behind.
fn node() -> Result<ServiceNode, IpcError> {
    // Errors only: its warnings are about missing configuration files and dead peers, which are
    // ordinary here and reported by plumbline itself. IOX2_LOG_LEVEL turns them on.
    static QUIET: Once = Once::new();
    QUIET.call_once(|| {
        set_logger(&Logger);
        set_log_level_from_env_or(LogLevel::Error);
    });
    let failed = |error: String| transport("making a node for", "plumbline", error);
    let root = runtime_dir::directory().map_err(|error| failed(error.to_string()))?;
    let config = config(&root).map_err(failed)?;
    // A segment that finds no room ends its maker by a signal (SIGBUS).
    if let Some(full) = runtime_dir::no_room() {
        return Err(failed(full));
    }
    incomplete_segments::start_sweeper();
    // Signals belong to the program, not to this library.
    let builder = NodeBuilder::new().config(&config).signal_handling_mode(SignalHandlingMode::Disabled);
    let node = builder.create().map_err(|error| failed(error.to_string()))?;
    runtime_dir::close_to_others();
    Ok(node)
}

/// iceoryx2's lines go where all others go: its own logger writes to standard error on the calling thread, which then waits for the reader.
struct Logger;

impl iceoryx2_log::Log for Logger {
    fn log(&self, level: LogLevel, origin: std::fmt::Arguments, message: std::fmt::Arguments) {
        match level {
            LogLevel::Fatal | LogLevel::Error => tracing::error!("iceoryx2: {message}"),
            LogLevel::Warn => tracing::warn!("iceoryx2: {message}"),
            LogLevel::Info => tracing::info!("iceoryx2: {message}"),
            LogLevel::Debug => tracing::debug!("iceoryx2: {origin}: {message}"),
            LogLevel::Trace => tracing::trace!("iceoryx2: {origin}: {message}"),
        }
    }
}

/// iceoryx2 in the folder `root`. No configuration file is read: one that lies about must not change where the arm is served.
fn config(root: &Path) -> Result<Config, String> {
    let names = root.join("iceoryx2");
    let text = names.to_str().ok_or_else(|| format!("{} is not UTF-8", names.display()))?;
    let refused = |error| format!("{text}: {error:?}");
    let mut config = Config::default();
    config.global.set_root_path(&iceoryx2::prelude::Path::new(text.as_bytes()).map_err(refused)?);
    config.global.prefix = FileName::new(runtime_dir::prefix(runtime_dir::user()).as_bytes()).map_err(refused)?;
    Ok(config)
}

pub(super) fn samples_name(robot: &RobotId) -> String {
    format!("plumbline/{robot}/samples")
}

pub(super) fn replay_name(robot: &RobotId) -> String {
    format!("plumbline/{robot}/replay")
}

pub(super) fn feed_forward_name(robot: &RobotId) -> String {
    format!("plumbline/{robot}/feed-forward")
}

pub(super) fn command_name(robot: &RobotId) -> String {
    format!("plumbline/{robot}/command")
}

fn service_name(name: &str) -> Result<ServiceName, IpcError> {
    name.try_into().map_err(|error| transport("naming", name, format!("{error:?}")))
}

fn samples(node: &ServiceNode, name: &str) -> Result<pubsub::Builder<[SampleMessage], (), ipc::Service>, IpcError> {
    Ok(node.service_builder(&service_name(name)?).publish_subscribe::<[SampleMessage]>())
}

fn feed_forward(
    node: &ServiceNode,
    name: &str,
) -> Result<pubsub::Builder<FeedForwardMessage, (), ipc::Service>, IpcError> {
    Ok(node.service_builder(&service_name(name)?).publish_subscribe::<FeedForwardMessage>())
}

type ReplayBuilder = reqres::Builder<FollowRequest, (), [SampleMessage], ReplayHeader, ipc::Service>;

fn replay(node: &ServiceNode, name: &str) -> Result<ReplayBuilder, IpcError> {
    Ok(node
        .service_builder(&service_name(name)?)
        .request_response::<FollowRequest, [SampleMessage]>()
        .response_user_header::<ReplayHeader>())
}

type CommandsBuilder = reqres::Builder<[u8], (), [u8], (), ipc::Service>;

fn commands(node: &ServiceNode, name: &str) -> Result<CommandsBuilder, IpcError> {
    Ok(node.service_builder(&service_name(name)?).request_response::<[u8], [u8]>())
}

/// Opens or makes the sample stream; only the daemon decides on sizes.
pub(super) fn serve_samples(node: &ServiceNode, robot: &RobotId) -> Result<Samples, IpcError> {
    let name = samples_name(robot);
    patiently(&name, SERVER_PATIENCE, || {
        Ok(samples(node, &name)?
            // A full buffer keeps its oldest, unbroken run; what comes after it is fetched by replay.
            .enable_safe_overflow(false)
            .subscriber_max_buffer_size(STREAM_BUFFER)
            .subscriber_max_borrowed_samples(1)
            .history_size(0)
            .max_publishers(1)
            .max_subscribers(MAX_FOLLOWERS)
            .max_nodes(MAX_FOLLOWERS + SPARE_NODES)
            .open_or_create())
    })
}

/// Opens or makes the replay service.
pub(super) fn serve_replay(node: &ServiceNode, robot: &RobotId) -> Result<Replay, IpcError> {
    let name = replay_name(robot);
    patiently(&name, SERVER_PATIENCE, || {
        Ok(replay(node, &name)?
            .enable_safe_overflow_for_requests(false)
            .enable_safe_overflow_for_responses(false)
            .enable_fire_and_forget_requests(true)
            .max_active_requests_per_client(2)
            .max_loaned_requests(1)
            .max_response_buffer_size(1)
            .max_borrowed_responses_per_pending_response(1)
            .max_servers(1)
            .max_clients(MAX_FOLLOWERS)
            .max_nodes(MAX_FOLLOWERS + SPARE_NODES)
            .open_or_create())
    })
}

/// Opens or makes the feed-forward service: one value, the newest, always.
pub(super) fn serve_feed_forward(node: &ServiceNode, robot: &RobotId) -> Result<FeedForward, IpcError> {
    let name = feed_forward_name(robot);
    patiently(&name, SERVER_PATIENCE, || {
        Ok(feed_forward(node, &name)?
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(1)
            .subscriber_max_borrowed_samples(1)
            .history_size(1)
            .max_publishers(1)
            .max_subscribers(MAX_FEED_FORWARD_CLIENTS)
            .max_nodes(MAX_FEED_FORWARD_CLIENTS + SPARE_NODES)
            .open_or_create())
    })
}

/// Opens or makes the command service.
pub(super) fn serve_commands(node: &ServiceNode, robot: &RobotId) -> Result<Commands, IpcError> {
    let name = command_name(robot);
    patiently(&name, SERVER_PATIENCE, || {
        Ok(commands(node, &name)?
            .enable_safe_overflow_for_requests(false)
            .enable_safe_overflow_for_responses(false)
            .enable_fire_and_forget_requests(true)
            .max_active_requests_per_client(2)
            .max_loaned_requests(1)
            .max_response_buffer_size(1)
            .max_borrowed_responses_per_pending_response(1)
            .max_servers(1)
            .max_clients(MAX_COMMAND_CLIENTS)
            .max_nodes(MAX_COMMAND_CLIENTS + SPARE_NODES)
            .open_or_create())
    })
}

/// Opens the sample stream of a daemon.
pub(super) fn join_samples(node: &ServiceNode, robot: &RobotId, patience: Duration) -> Result<Samples, IpcError> {
    let name = samples_name(robot);
    joined(robot, patience, patiently(&name, patience, || Ok(samples(node, &name)?.open())))
}

/// Opens the replay service of a daemon.
pub(super) fn join_replay(node: &ServiceNode, robot: &RobotId, patience: Duration) -> Result<Replay, IpcError> {
    let name = replay_name(robot);
    joined(robot, patience, patiently(&name, patience, || Ok(replay(node, &name)?.open())))
}

/// Opens the feed-forward of a daemon.
pub(super) fn join_feed_forward(
    node: &ServiceNode,
    robot: &RobotId,
    patience: Duration,
) -> Result<FeedForward, IpcError> {
    let name = feed_forward_name(robot);
    joined(robot, patience, patiently(&name, patience, || Ok(feed_forward(node, &name)?.open())))
}

/// Opens the command service of a daemon.
pub(super) fn join_commands(node: &ServiceNode, robot: &RobotId, patience: Duration) -> Result<Commands, IpcError> {
    let name = command_name(robot);
    joined(robot, patience, patiently(&name, patience, || Ok(commands(node, &name)?.open())))
}

/// How long the daemon tries: another process may be cleaning up after a killed one just now.
pub(super) const SERVER_PATIENCE: Duration = Duration::from_secs(3);

/// Attempts until it works, fails for good, or `patience` is over.
pub(super) fn patiently<T, E: Display>(
    service: &str,
    patience: Duration,
    mut attempt: impl FnMut() -> Result<Result<T, E>, IpcError>,
) -> Result<T, IpcError> {
    let start = Instant::now();
    loop {
        let error = match attempt()? {
            Ok(opened) => return Ok(opened),
            Err(error) => classify(service, &error.to_string()),
        };
        if matches!(error, IpcError::Incompatible { .. }) || start.elapsed() >= patience {
            return Err(error);
        }
        thread::sleep(RETRY);
    }
}

/// Turns iceoryx2's error into ours by its variant's name: each of its builders has an error enum of its own, whose
/// variants are alike in name only.
fn classify(service: &str, reason: &str) -> IpcError {
    let service = service.to_string();
    if ["Incompatible", "DoesNotSupport", "VersionMismatch"].iter().any(|word| reason.contains(word)) {
        return IpcError::Incompatible { service, reason: reason.to_string() };
    }
    match reason.split("ExceedsMax").nth(1) {
        Some(what) if what.contains("Publisher") => IpcError::Full { service, port: "publisher".into() },
        Some(what) if what.contains("Subscriber") => IpcError::Full { service, port: "subscriber".into() },
        Some(what) if what.contains("Server") => IpcError::Full { service, port: "server".into() },
        Some(what) if what.contains("Client") => IpcError::Full { service, port: "client".into() },
        Some(_) => IpcError::Full { service, port: "process".into() },
        None => IpcError::Transport { doing: "opening", service, reason: reason.to_string() },
    }
}

/// A service that does not exist means that there is no daemon; one whose memory is a stranger's is not believed.
fn joined<T>(robot: &RobotId, patience: Duration, result: Result<T, IpcError>) -> Result<T, IpcError> {
    let opened = result.map_err(|error| match error {
        IpcError::Transport { reason, .. } if reason.contains("DoesNotExist") => no_daemon(robot, patience),
        other => other,
    })?;
    runtime_dir::only_ours_mapped().map_err(|error| transport("joining", robot.as_str(), error))?;
    Ok(opened)
}

/// The error for a command service without a place, with those who have them.
pub(super) fn full(name: &str, service: &Commands) -> IpcError {
    let mut processes = BTreeMap::<u32, usize>::new();
    service.dynamic_config().list_clients(|details| {
        *processes.entry(process(details.client_id.value())).or_default() += 1;
        CallbackProgression::Continue
    });
    let each = processes.iter().map(|(process, places)| format!("process {process} has {places}"));
    let holders = each.collect::<Vec<_>>().join(", ");
    let port = format!("client: of {MAX_COMMAND_CLIENTS} places ({OPERATORS} for operators) {holders}");
    IpcError::Full { service: name.to_string(), port }
}

/// The process that made a port or a node: the third 32 bits of its number.
pub(super) fn process(id: u128) -> u32 {
    (id >> 64) as u32
}

/// Whether the process behind a node still runs. A node that is not there any more was cleaned up after its end.
pub(super) fn runs(node: &ServiceNode, id: UniqueNodeId) -> bool {
    !matches!(Node::<ipc::Service>::state_of(node.config(), id), Ok(None | Some(NodeState::Dead(_))))
}

/// The error for a robot that nobody serves.
pub(super) fn no_daemon(robot: &RobotId, waited: Duration) -> IpcError {
    IpcError::NoDaemon { robot: robot.to_string(), waited_ms: waited.as_millis() as u64 }
}

/// iceoryx2 failed while `doing` something with `service`.
pub(super) fn transport(doing: &'static str, service: &str, error: impl Display) -> IpcError {
    IpcError::Transport { doing, service: service.to_string(), reason: error.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_say_what_a_person_can_act_on() {
        let class = |reason: &str| classify("s", reason);
        assert!(matches!(class("PublishSubscribeOpenError::IncompatibleTypes"), IpcError::Incompatible { .. }));
        let sizes = "RequestResponseOpenError::DoesNotSupportRequestedAmountOfClients";
        assert!(matches!(class(sizes), IpcError::Incompatible { .. }));
        let full = class("PublisherCreateError::ExceedsMaxSupportedPublishers");
        assert_eq!(full, IpcError::Full { service: "s".into(), port: "publisher".into() });
        assert!(matches!(class("PublishSubscribeOpenError::DoesNotExist"), IpcError::Transport { .. }));

        let robot = RobotId::parse("test", "robot", "nobody").unwrap();
        let absent = joined::<()>(&robot, Duration::ZERO, Err(class("PublishSubscribeOpenError::DoesNotExist")));
        assert_eq!(absent, Err(IpcError::NoDaemon { robot: "nobody".into(), waited_ms: 0 }));
    }
}
