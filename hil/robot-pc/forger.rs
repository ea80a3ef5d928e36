//! Tries to pass torques and models of its own off as the daemon's, with nothing of plumbline's own care in the way: straight through
//! iceoryx2, under whatever folder of names and prefix it is told.
//!
//!     forger FOLDER PREFIX ROBOT
//!
//! One line per attempt. Exit code 0 when one was let in, 1 when none was. hil/robot-pc/inside/strangers.sh runs it as another user; run as the
//! daemon's own user it is let in, which shows that the attempts are real ones.

use iceoryx2::prelude::*;
use plumbline_ipc::FeedForwardMessage;
use std::error::Error;
use std::fmt::Debug;
use std::process::ExitCode;
use std::time::Duration;

/// Nm on every joint; nobody's model asks for so much.
const FORGED: f64 = 99.0;

fn words(error: impl Debug) -> Box<dyn Error> {
    format!("{error:?}").into()
}

fn node(folder: &str, prefix: &str) -> Result<Node<ipc::Service>, Box<dyn Error>> {
    let mut config = Config::default();
    config.global.set_root_path(&Path::new(format!("{folder}/iceoryx2").as_bytes()).map_err(words)?);
    config.global.prefix = FileName::new(prefix.as_bytes()).map_err(words)?;
    let builder = NodeBuilder::new().config(&config).signal_handling_mode(SignalHandlingMode::Disabled);
    builder.create::<ipc::Service>().map_err(words)
}

/// A second publisher of the feed-forward torque, under the limits that the service has.
fn feed_forward(folder: &str, prefix: &str, robot: &str) -> Result<String, Box<dyn Error>> {
    let node = node(folder, prefix)?;
    let name: ServiceName = format!("plumbline/{robot}/feed-forward").as_str().try_into().map_err(words)?;
    let service = node.service_builder(&name).publish_subscribe::<FeedForwardMessage>().open().map_err(words)?;
    let publisher = service.publisher_builder().create().map_err(words)?;
    let message = FeedForwardMessage { tau_ff: [FORGED; 8], model: 1, n: 7, ..FeedForwardMessage::default() };
    let readers = publisher.send_copy(message).map_err(words)?;
    Ok(format!("sent to {readers} readers"))
}

/// The same service made anew, for readers that find it first.
fn rival(folder: &str, prefix: &str, robot: &str) -> Result<String, Box<dyn Error>> {
    let node = node(folder, prefix)?;
    let name: ServiceName = format!("plumbline/{robot}/feed-forward").as_str().try_into().map_err(words)?;
    node.service_builder(&name).publish_subscribe::<FeedForwardMessage>().create().map_err(words)?;
    Ok("made".into())
}

/// A request to the daemon that offers a model; it is no good one, and its answer says that it arrived.
fn model(folder: &str, prefix: &str, robot: &str) -> Result<String, Box<dyn Error>> {
    let node = node(folder, prefix)?;
    let name: ServiceName = format!("plumbline/{robot}/command").as_str().try_into().map_err(words)?;
    let service = node.service_builder(&name).request_response::<[u8], [u8]>().open().map_err(words)?;
    let client = service.client_builder().initial_max_slice_len(256).create().map_err(words)?;
    let request = br#"{"request":"offer-model","toml":"forged = true"}"#;
    let pending =
        client.loan_slice_uninit(request.len()).map_err(words)?.write_from_slice(request).send().map_err(words)?;
    for _ in 0..200 {
        if let Some(answer) = pending.receive().map_err(words)? {
            return Ok(String::from_utf8_lossy(answer.payload()).chars().take(80).collect());
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Err("no answer".into())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, prefix, robot] = &arguments[..] else {
        eprintln!("forger FOLDER PREFIX ROBOT");
        return ExitCode::from(2);
    };
    set_log_level(LogLevel::Fatal);
    type Attempt = fn(&str, &str, &str) -> Result<String, Box<dyn Error>>;
    let attempts: [(&str, Attempt); 3] = [("model", model), ("feed-forward", feed_forward), ("rival", rival)];
    let mut let_in = false;
    for (what, attempt) in attempts {
        match attempt(folder, prefix, robot) {
            Ok(how) => {
                let_in = true;
                println!("{what}: LET IN: {how}");
            }
            Err(why) => println!("{what}: refused: {why}"),
        }
    }
    if let_in { ExitCode::SUCCESS } else { ExitCode::from(1) }
}
