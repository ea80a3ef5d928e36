//! Sends forged torques and models in the daemon's name through iceoryx2 itself, without the checks of plumbline's library, under the given
//! folder of names and prefix.
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

/// Forged torque of every joint, beyond any model's \[Nm\].
const FORGED_NM: f64 = 99.0;

fn boxed(error: impl Debug) -> Box<dyn Error> {
    format!("{error:?}").into()
}

fn node(folder: &str, prefix: &str) -> Result<Node<ipc::Service>, Box<dyn Error>> {
    let mut config = Config::default();
    config.global.set_root_path(&Path::new(format!("{folder}/iceoryx2").as_bytes()).map_err(boxed)?);
    config.global.prefix = FileName::new(prefix.as_bytes()).map_err(boxed)?;
    let builder = NodeBuilder::new().config(&config).signal_handling_mode(SignalHandlingMode::Disabled);
    builder.create::<ipc::Service>().map_err(boxed)
}

/// A second publisher of the feed-forward torque, under the limits that the service has.
fn feed_forward(folder: &str, prefix: &str, robot: &str) -> Result<String, Box<dyn Error>> {
    let node = node(folder, prefix)?;
    let name: ServiceName = format!("plumbline/{robot}/feed-forward").as_str().try_into().map_err(boxed)?;
    let service = node.service_builder(&name).publish_subscribe::<FeedForwardMessage>().open().map_err(boxed)?;
    let publisher = service.publisher_builder().create().map_err(boxed)?;
    let message = FeedForwardMessage { tau_ff: [FORGED_NM; 8], model: 1, n: 7, ..FeedForwardMessage::default() };
    let readers = publisher.send_copy(message).map_err(boxed)?;
    Ok(format!("sent to {readers} readers"))
}

/// The same service made anew, for readers that find it first.
fn second_service(folder: &str, prefix: &str, robot: &str) -> Result<String, Box<dyn Error>> {
    let node = node(folder, prefix)?;
    let name: ServiceName = format!("plumbline/{robot}/feed-forward").as_str().try_into().map_err(boxed)?;
    node.service_builder(&name).publish_subscribe::<FeedForwardMessage>().create().map_err(boxed)?;
    Ok("made".into())
}

/// A request to the daemon that offers a model; it is no good one, and its answer says that it arrived.
fn model(folder: &str, prefix: &str, robot: &str) -> Result<String, Box<dyn Error>> {
    let node = node(folder, prefix)?;
    let name: ServiceName = format!("plumbline/{robot}/command").as_str().try_into().map_err(boxed)?;
    let service = node.service_builder(&name).request_response::<[u8], [u8]>().open().map_err(boxed)?;
    let client = service.client_builder().initial_max_slice_len(256).create().map_err(boxed)?;
    let request = br#"{"request":"offer-model","toml":"forged = true"}"#;
    let pending =
        client.loan_slice_uninit(request.len()).map_err(boxed)?.write_from_slice(request).send().map_err(boxed)?;
    for _ in 0..200 {
        if let Some(answer) = pending.receive().map_err(boxed)? {
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
    let attempts: [(&str, Attempt); 3] =
        [("model", model), ("feed-forward", feed_forward), ("second_service", second_service)];
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
