//! The iceoryx2 services: names, sizes, creation by the daemon and opening by clients.

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
use super::messages::{FeedForwardMessage, FollowRequest, GuestMessage, ModelHeader, ReplayHeader, SampleMessage};
use super::robot::RobotId;
use super::runtime_dir;

pub(super) const MAX_BATCH_RECORDS: usize = 32;
/// Maximum records in one replay response (340 KiB).
pub(super) const MAX_REPLAY_RECORDS: usize = 512;
/// Capacity of a follower's buffer in batches.
const STREAM_BUFFER_BATCHES: usize = 256;
const MAX_FOLLOWERS: usize = 4;
/// Maximum displays of the samples, which take no place of a follower.
const MAX_WATCHERS: usize = 4;
const MAX_FEED_FORWARD_CLIENTS: usize = 32;
const MAX_MODEL_CLIENTS: usize = 16;
/// Publishers of the latest torque and of the served model: the daemon, and a tunnel to another machine, which publishes on both sides.
const MAX_LATEST_PUBLISHERS: usize = 2;
/// Receivers of an arm's states: the daemon, and one whose process was killed.
const MAX_GUEST_RECEIVERS: usize = 2;
pub(super) const MAX_COMMAND_CLIENTS: usize = 16;
/// Clients of the command service that are reserved for operators.
pub(super) const RESERVED_OPERATORS: usize = 4;
/// Nodes beyond the clients: the daemon, and dead nodes that are not cleaned up yet.
const SPARE_NODES: usize = 16;
/// Pause between two attempts to open a service.
const RETRY_INTERVAL: Duration = Duration::from_millis(10);

pub(super) type ServiceNode = Node<ipc::Service>;
pub(super) type Samples = publish_subscribe::PortFactory<ipc::Service, [SampleMessage], ()>;
pub(super) type FeedForward = publish_subscribe::PortFactory<ipc::Service, FeedForwardMessage, ()>;
/// The same for a client that may move between threads: another lock in this process, the same memory.
pub(super) type FeedForwardForThreads = publish_subscribe::PortFactory<ipc_threadsafe::Service, FeedForwardMessage, ()>;
pub(super) type Model = publish_subscribe::PortFactory<ipc::Service, [u8], ModelHeader>;
pub(super) type Guest = publish_subscribe::PortFactory<ipc::Service, [GuestMessage], ()>;
pub(super) type Replay = request_response::PortFactory<ipc::Service, FollowRequest, (), [SampleMessage], ReplayHeader>;
pub(super) type Commands = request_response::PortFactory<ipc::Service, [u8], (), [u8], ()>;

/// Time now, `CLOCK_BOOTTIME` \[ns\]: `CLOCK_MONOTONIC` plus the time suspended. Clients compute the age of values with it.
pub fn boot_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    (now.tv_sec as u64).saturating_mul(1_000_000_000).saturating_add(now.tv_nsec as u64)
}

/// Time that the machine has been suspended since boot \[ns\]: `boot_ns() - now_ns()`. Low by the time between the two reads, never high.
pub(super) fn suspended_ns() -> u64 {
    let boot = boot_ns();
    boot.saturating_sub(now_ns())
}

/// Time now, `CLOCK_MONOTONIC` \[ns\]: the clock of records and of the daemon.
pub fn now_ns() -> u64 {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    (now.tv_sec as u64).saturating_mul(1_000_000_000).saturating_add(now.tv_nsec as u64)
}

/// Node of a daemon, which creates the services.
///
/// # Errors
/// Files with plumbline's prefix in shared memory belong to another user.
pub(super) fn serving_node() -> Result<ServiceNode, IpcError> {
    runtime_dir::check_no_foreign_files().map_err(|error| transport("creating a node for", "plumbline", error))?;
    node()
}

/// Node of a client. Foreign files with plumbline's prefix only cause a warning: they must not prevent a client from stopping the arm.
pub(super) fn joining_node<S: Service>() -> Result<Node<S>, IpcError> {
    // Once per process: a client may connect for every request.
    static WARNED: Once = Once::new();
    if let Err(foreign) = runtime_dir::check_no_foreign_files() {
        WARNED.call_once(|| {
            tracing::warn!("{foreign}; the running daemon is not affected, but the next daemon will refuse to start")
        });
    }
    node()
}

/// Node of this process. Its creation removes the resources of killed processes.
fn node<S: Service>() -> Result<Node<S>, IpcError> {
    // Errors only. iceoryx2 warns of missing configuration files and dead peers, which are normal here.
    // IOX2_LOG_LEVEL enables its warnings.
    static LOGGER_SET: Once = Once::new();
    LOGGER_SET.call_once(|| {
        set_logger(&Logger);
        set_log_level_from_env_or(LogLevel::Error);
    });
    let failed = |error: String| transport("creating a node for", "plumbline", error);
    let root = runtime_dir::directory().map_err(|error| failed(error.to_string()))?;
    let config = config(&root).map_err(failed)?;
    // The kernel ends a process that writes to a segment without memory (SIGBUS).
    if let Some(full) = runtime_dir::shared_memory_full() {
        return Err(failed(full));
    }
    incomplete_segments::start_sweeper();
    // The program handles signals, not this library.
    let builder = NodeBuilder::new().config(&config).signal_handling_mode(SignalHandlingMode::Disabled);
    let node = builder.create().map_err(|error| failed(error.to_string()))?;
    runtime_dir::restrict_global_segment();
    Ok(node)
}

/// Forwards iceoryx2's log to `tracing`. iceoryx2's default logger writes to standard error on the calling thread, which can block.
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

/// Configuration of iceoryx2 with its files in `root`. No configuration file is read: a stray file must not change where the arm is served.
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

pub(super) fn model_name(robot: &RobotId) -> String {
    format!("plumbline/{robot}/model")
}

pub(super) fn guest_name(robot: &RobotId) -> String {
    format!("plumbline/{robot}/guest")
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

fn feed_forward<S: Service>(
    node: &Node<S>,
    name: &str,
) -> Result<pubsub::Builder<FeedForwardMessage, (), S>, IpcError> {
    Ok(node.service_builder(&service_name(name)?).publish_subscribe::<FeedForwardMessage>())
}

fn model(node: &ServiceNode, name: &str) -> Result<pubsub::Builder<[u8], ModelHeader, ipc::Service>, IpcError> {
    Ok(node.service_builder(&service_name(name)?).publish_subscribe::<[u8]>().user_header::<ModelHeader>())
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

/// A request-response service of one server; the builders of two services are two types.
macro_rules! serve_one_server {
    ($builder:expr, $clients:expr) => {
        $builder
            .enable_safe_overflow_for_requests(false)
            .enable_safe_overflow_for_responses(false)
            .enable_fire_and_forget_requests(true)
            .max_active_requests_per_client(2)
            .max_loaned_requests(1)
            .max_response_buffer_size(1)
            .max_borrowed_responses_per_pending_response(1)
            .max_servers(1)
            .max_clients($clients)
            .max_nodes($clients + SPARE_NODES)
            .open_or_create()
    };
}

/// Opens or creates the sample stream. The daemon alone sets the sizes.
pub(super) fn serve_samples(node: &ServiceNode, robot: &RobotId) -> Result<Samples, IpcError> {
    let name = samples_name(robot);
    retry_until(&name, SERVER_TIMEOUT, || {
        Ok(samples(node, &name)?
            // A full buffer keeps its oldest records; later ones are fetched by replay.
            .enable_safe_overflow(false)
            .subscriber_max_buffer_size(STREAM_BUFFER_BATCHES)
            .subscriber_max_borrowed_samples(1)
            .history_size(0)
            .max_publishers(1)
            .max_subscribers(MAX_FOLLOWERS + MAX_WATCHERS)
            .max_nodes(MAX_FOLLOWERS + MAX_WATCHERS + SPARE_NODES)
            .open_or_create())
    })
}

pub(super) fn serve_replay(node: &ServiceNode, robot: &RobotId) -> Result<Replay, IpcError> {
    let name = replay_name(robot);
    retry_until(&name, SERVER_TIMEOUT, || Ok(serve_one_server!(replay(node, &name)?, MAX_FOLLOWERS)))
}

/// Opens or creates the feed-forward service. Its buffer holds the latest value only.
pub(super) fn serve_feed_forward(node: &ServiceNode, robot: &RobotId) -> Result<FeedForward, IpcError> {
    let name = feed_forward_name(robot);
    retry_until(&name, SERVER_TIMEOUT, || {
        Ok(feed_forward(node, &name)?
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(1)
            .subscriber_max_borrowed_samples(1)
            .history_size(1)
            .max_publishers(MAX_LATEST_PUBLISHERS)
            .max_subscribers(MAX_FEED_FORWARD_CLIENTS)
            .max_nodes(MAX_FEED_FORWARD_CLIENTS + SPARE_NODES)
            .open_or_create())
    })
}

/// Opens or creates the service of the served model. Its buffer holds the latest one only.
pub(super) fn serve_model(node: &ServiceNode, robot: &RobotId) -> Result<Model, IpcError> {
    let name = model_name(robot);
    retry_until(&name, SERVER_TIMEOUT, || {
        Ok(model(node, &name)?
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(1)
            .subscriber_max_borrowed_samples(1)
            .history_size(1)
            .max_publishers(MAX_LATEST_PUBLISHERS)
            .max_subscribers(MAX_MODEL_CLIENTS)
            .max_nodes(MAX_MODEL_CLIENTS + SPARE_NODES)
            .open_or_create())
    })
}

/// Opens or creates the service of an arm's states, for its one publisher and for the receiver alike.
pub(super) fn open_guest(node: &ServiceNode, robot: &RobotId) -> Result<Guest, IpcError> {
    let name = guest_name(robot);
    let opened = retry_until(&name, SERVER_TIMEOUT, || {
        let builder = node.service_builder(&service_name(&name)?).publish_subscribe::<[GuestMessage]>();
        Ok(builder
            .enable_safe_overflow(true)
            .subscriber_max_buffer_size(STREAM_BUFFER_BATCHES)
            .subscriber_max_borrowed_samples(1)
            .history_size(0)
            .max_publishers(1)
            .max_subscribers(MAX_GUEST_RECEIVERS)
            .max_nodes(MAX_GUEST_RECEIVERS + SPARE_NODES)
            .open_or_create())
    })?;
    runtime_dir::check_mapped_owner().map_err(|error| transport("opening", robot.as_str(), error))?;
    Ok(opened)
}

pub(super) fn serve_commands(node: &ServiceNode, robot: &RobotId) -> Result<Commands, IpcError> {
    let name = command_name(robot);
    retry_until(&name, SERVER_TIMEOUT, || Ok(serve_one_server!(commands(node, &name)?, MAX_COMMAND_CLIENTS)))
}

/// Functions that open a service of a daemon.
macro_rules! join {
    ($($join:ident: $node:ty, $builder:ident, $name:ident -> $service:ty;)+) => {$(
        pub(super) fn $join(node: &$node, robot: &RobotId, timeout: Duration) -> Result<$service, IpcError> {
            let name = $name(robot);
            joined(robot, timeout, retry_until(&name, timeout, || Ok($builder(node, &name)?.open())))
        }
    )+};
}

join! {
    join_samples: ServiceNode, samples, samples_name -> Samples;
    join_replay: ServiceNode, replay, replay_name -> Replay;
    join_feed_forward: Node<ipc_threadsafe::Service>, feed_forward, feed_forward_name -> FeedForwardForThreads;
    join_model: ServiceNode, model, model_name -> Model;
    join_commands: ServiceNode, commands, command_name -> Commands;
}

/// Timeout of the daemon for opening a service: another process may still be cleaning up after a killed one.
pub(super) const SERVER_TIMEOUT: Duration = Duration::from_secs(3);

/// Retries `attempt` until it succeeds, fails permanently, or `timeout` has passed.
pub(super) fn retry_until<T, E: Display>(
    service: &str,
    timeout: Duration,
    mut attempt: impl FnMut() -> Result<Result<T, E>, IpcError>,
) -> Result<T, IpcError> {
    let start = Instant::now();
    loop {
        let error = match attempt()? {
            Ok(opened) => return Ok(opened),
            Err(error) => classify(service, &error.to_string()),
        };
        if matches!(error, IpcError::Incompatible { .. }) || start.elapsed() >= timeout {
            return Err(error);
        }
        thread::sleep(RETRY_INTERVAL);
    }
}

/// Maps an iceoryx2 error to [`IpcError`] by its variant's name: each builder has its own error enum with the same variant
/// names.
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

/// Result of opening a service: `NoDaemon` where the service does not exist, an error where its memory belongs to another user.
fn joined<T>(robot: &RobotId, timeout: Duration, result: Result<T, IpcError>) -> Result<T, IpcError> {
    let opened = result.map_err(|error| match error {
        IpcError::Transport { reason, .. } if reason.contains("DoesNotExist") => no_daemon(robot, timeout),
        other => other,
    })?;
    runtime_dir::check_mapped_owner().map_err(|error| transport("opening", robot.as_str(), error))?;
    Ok(opened)
}

/// `Full` error of the command service, with the processes that hold its client slots.
pub(super) fn full(name: &str, service: &Commands) -> IpcError {
    let mut processes = BTreeMap::<u32, usize>::new();
    service.dynamic_config().list_clients(|details| {
        *processes.entry(incomplete_segments::process(details.client_id.value())).or_default() += 1;
        CallbackProgression::Continue
    });
    let each = processes.iter().map(|(process, slots)| format!("process {process} has {slots}"));
    let holders = each.collect::<Vec<_>>().join(", ");
    let port = format!("client: of {MAX_COMMAND_CLIENTS} slots ({RESERVED_OPERATORS} for operators) {holders}");
    IpcError::Full { service: name.to_string(), port }
}

/// Whether the process of a node still runs. A node that does not exist was cleaned up after its process ended.
pub(super) fn runs<S: Service>(node: &Node<S>, id: UniqueNodeId) -> bool {
    !matches!(Node::<ipc::Service>::state_of(node.config(), id), Ok(None | Some(NodeState::Dead(_))))
}

pub(super) fn no_daemon(robot: &RobotId, waited: Duration) -> IpcError {
    IpcError::NoDaemon { robot: robot.to_string(), waited_ms: waited.as_millis() as u64 }
}

/// Error of iceoryx2 during `doing` with `service`.
pub(super) fn transport(doing: &'static str, service: &str, error: impl Display) -> IpcError {
    IpcError::Transport { doing, service: service.to_string(), reason: error.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn iceoryx2_errors_map_to_actionable_errors() {
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
