//! `plumbline run`: daemon, estimator and report on one machine, without systemd.

mod process;
mod watch;

use crate::analysis::next;
use crate::cli::output::Output;
use crate::cli::say::say;
use crate::config::job::Job;
use crate::dataset::Format;
use crate::failure::Failure;
use crate::process::owned;
use crate::process::signals::Ending;
use crate::report::Report;
use crate::report::provenance;
use crate::setup::programme::{Programme, Role};
use crate::setup::{JobOptions, programme, robot_id};
use clap::Args;
use plumbline_ipc::{Progress, RobotId};
use plumbline_model_file::models;
use process::{
    EstimatorOptions, POLL_INTERVAL, Process, START_TIMEOUT, Start, await_daemon, await_follower, start, status,
};
use std::ffi::OsStr;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};
use watch::Watch;

/// Options of `plumbline run`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    job: JobOptions,
    /// Model to serve until the identified one; needed for torque control of an arm that is not mounted upright
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    #[command(flatten)]
    output: Output,
}

impl Options {
    pub(super) fn output(&self) -> &Output {
        &self.output
    }
}

/// Timeout of a response.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(5);
/// Restarts of a killed estimator.
const MAX_ESTIMATOR_RESTARTS: usize = 3;
/// Room that a dataset takes per driven sample and joint, with positions, velocities, measured and served torques \[bytes\].
fn dataset_bytes(format: Format) -> u64 {
    match format {
        Format::Csv => 60,
        Format::Mcap => 32,
    }
}

/// Room for models, plans and the report \[bytes\].
const OTHER_BYTES: u64 = 20 << 20;

/// Runs the job, and again with the motion that is planned for what its diagnosis leaves open; then prints the results.
pub fn run(mut options: Options) -> Result<(), Failure> {
    let (job, _, out) = options.job.load()?;
    options.output.may_replace(&out, &job.file)?;
    let plan = out.join(next::FILE);
    let mut before: Option<PathBuf> = None;
    for round in 1..=1 + job.diagnosis.rounds {
        // That of an earlier job would be driven.
        crate::atomic::remove_file(&plan).map_err(Failure::job)?;
        one_round(&options, before.as_deref())?;
        if !plan.exists() {
            break;
        }
        let dir = out.join(format!("round-{round}"));
        put_aside(&out, &dir)?;
        if !options.output.quiet && !options.output.json {
            say!("round {round}: {}", dir.join("report.html").display());
            for line in Report::read(&dir)?.diagnosis_lines() {
                say!("  {line}");
            }
        }
        options.job.sets.extend(next_round(&dir, job.diagnosis.rounds - round)?);
        before = Some(dir);
    }
    options.output.show(&Report::read(&out)?, &out)
}

/// What a job of the next round has in the place of its own keys: the motion that was planned, and nothing else.
fn next_round(dir: &Path, rounds: usize) -> Result<[String; 6], Failure> {
    let plan = std::path::absolute(dir.join(next::FILE)).map_err(Failure::job)?;
    Ok([
        format!("excitation.plan={}", plan.display()),
        "excitation.trajectories=1".into(),
        "validation.trajectories=0".into(),
        "validation.counter-experiment=false".into(),
        "live.motion=0 s".into(),
        format!("diagnosis.rounds={rounds}"),
    ])
}

/// Moves the results of a round into a folder of their own, in the place of those of an earlier job.
fn put_aside(out: &Path, dir: &Path) -> Result<(), Failure> {
    let failed = |error: std::io::Error| Failure::job(format!("{}: {error}", dir.display()));
    match std::fs::remove_dir_all(dir) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(failed(error)),
        _ => std::fs::create_dir_all(dir).map_err(failed)?,
    }
    for entry in std::fs::read_dir(out).map_err(failed)? {
        let name = entry.map_err(failed)?.file_name();
        let text = name.to_string_lossy();
        let named = ["report.json", "report.html", "dataset", "plans", next::FILE].contains(&&*text);
        if named || (text.starts_with("model") && text.ends_with(".toml")) {
            std::fs::rename(out.join(&name), dir.join(&name)).map_err(failed)?;
        }
    }
    Ok(())
}

/// Plans, starts both processes and waits for the results. `before` holds those of the round before.
fn one_round(options: &Options, before: Option<&Path>) -> Result<(), Failure> {
    let (job, robot, out) = options.job.load()?;
    let id = robot_id(&job)?;
    // The lock excludes another daemon for this robot during planning; the daemon below inherits it.
    let lock = crate::setup::lock(&id)?;
    // The checks of the daemon, before any process starts.
    let connector = crate::setup::backend::connector(&job, &robot)?;
    let arm = crate::setup::arm_lock(connector.as_ref())?;
    crate::setup::rest(&job, &robot)?;
    crate::daemon::metrics::bind(&job)?;
    if let Some(model) = &options.model {
        models::of_robot(&model.display().to_string(), &owned::read_model(model)?, &robot, "the job's robot")?;
    }
    std::fs::create_dir_all(&out).map_err(|error| Failure::job(format!("{}: {error}", out.display())))?;
    let arm_limits = connector.read_limits().map_err(Failure::job)?;
    let programme = programme::plan_or_load(&job, &robot, &out, arm_limits.as_ref())?;
    expect_room(&out, needed(&job, &programme, robot.chain.len()), job.output.dataset)?;

    let ending = Ending::watch()?;
    // The inheritable lock is closed again before another process starts.
    let passed_on = lock.pass_on().map_err(Failure::job)?;
    // The daemon locks the arm itself.
    drop(arm);
    let mut more: Vec<&OsStr> = ["--end-with-stdin", "--adopt-lock"].map(OsStr::new).to_vec();
    if let Some(model) = &options.model {
        more.extend([OsStr::new("--model"), model.as_os_str()]);
    }
    let of = Start { job: &options.job, out: &out, log: options.output.log_filter() };
    let mut daemon = Process::start("daemon", of, &more, Stdio::inherit())?;
    drop(passed_on);
    let command = provenance::command_line().unwrap_or_default();
    let results = EstimatorOptions { start: of, before, command: &command };
    // With the log, which has them, motions need no line of their own.
    let watch = Watch::new(&programme, !options.output.quiet && !options.output.verbose);
    let outcome = drive(&id, results, &mut daemon, watch, &ending);
    // The daemon ends with a controlled stop if the arm moves.
    let ended = daemon.end()?;
    outcome?;
    if !ended.success() {
        return Err(Failure::job(format!("the daemon failed: {ended}")));
    }
    Ok(())
}

/// Room that the results of a job take \[bytes\].
fn needed(job: &Job, programme: &Programme, joints: usize) -> u64 {
    let kept = |role: Role| matches!(role, Role::Identify | Role::Validate) && job.output.dataset;
    let ticks: usize = programme.motions().filter(|motion| kept(motion.role)).map(|motion| motion.ticks()).sum();
    OTHER_BYTES + dataset_bytes(job.output.dataset_format) * (ticks * joints) as u64
}

/// Refuses to drive where the results will not fit on the disk.
fn expect_room(out: &Path, needed: u64, dataset: bool) -> Result<(), Failure> {
    // A file system that does not tell its room is no reason to refuse.
    let Ok(system) = rustix::fs::statvfs(out) else { return Ok(()) };
    let free = system.f_bavail.saturating_mul(system.f_frsize);
    if free >= needed {
        return Ok(());
    }
    let mega = |bytes: u64| bytes.div_ceil(1 << 20);
    let dataset = if dataset { "; `output.dataset = false` keeps no recordings" } else { "" };
    Err(Failure::job(format!(
        "{}: {} MiB are free, and the results of this job take about {} MiB; nothing was driven{dataset}",
        out.display(),
        mega(free),
        mega(needed)
    )))
}

fn drive(
    id: &RobotId,
    results: EstimatorOptions,
    daemon: &mut Process,
    mut watch: Watch,
    ending: &Ending,
) -> Result<(), Failure> {
    let mut client = await_daemon(id, daemon)?;
    let (mut estimator, mut stages) = results.start()?;
    let outcome = (|| {
        await_follower(&mut client, daemon, &mut estimator)?;
        start(&mut client, ending)?;
        let mut restarts = 0;
        let mut stopped: Option<Instant> = None;
        loop {
            std::thread::sleep(POLL_INTERVAL);
            if let Some(cause) = ending.cause() {
                return Err(Failure::job(format!("interrupted, {cause}; the arm was stopped")));
            }
            if let Some(ended) = daemon.ended()? {
                return Err(Failure::job(format!("the daemon ended during the job: {ended}")));
            }
            match estimator.ended()? {
                Some(ended) if ended.success() => break,
                Some(ended) if ended.code().is_none() && restarts < MAX_ESTIMATOR_RESTARTS => {
                    restarts += 1;
                    tracing::warn!("the estimator was killed ({ended}); a new one continues with the daemon's samples");
                    (estimator, stages) = results.start()?;
                }
                Some(ended) => {
                    let stopped = status(&mut client).and_then(|now| now.stopped);
                    let why = stopped
                        .map_or(format!("the estimator ended: {ended}"), |why| format!("the arm was stopped: {why}"));
                    return Err(Failure::job(why));
                }
                None => {}
            }
            // A missing response is ignored: an ended daemon is detected above.
            if let Some(now) = status(&mut client) {
                watch.show(&now, &stages);
                // The estimator should end by itself after a stop.
                if now.progress == Progress::Stopped
                    && stopped.get_or_insert_with(Instant::now).elapsed() > START_TIMEOUT
                {
                    let why = now.stopped.unwrap_or_default();
                    return Err(Failure::job(format!(
                        "the arm was stopped: {why}; the estimator did not end by itself"
                    )));
                }
            }
        }
        watch.done();
        Ok(())
    })();
    if outcome.is_err() && estimator.ended()?.is_none() {
        estimator.child.kill().map_err(Failure::job)?;
        estimator.child.wait().map_err(Failure::job)?;
    }
    outcome
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_whose_results_do_not_fit_drives_nothing() {
        // /proc keeps no files of ours: it has no free space.
        let refused = expect_room(Path::new("/proc"), OTHER_BYTES, true).unwrap_err();
        let words = ["/proc: 0 MiB are free", "about 20 MiB", "nothing was driven", "`output.dataset = false`"];
        assert!(refused.code() == 1 && words.iter().all(|word| refused.to_string().contains(word)), "{refused}");
        let folder = tempfile::tempdir().unwrap();
        assert!(expect_room(folder.path(), 1, true).is_ok());
        assert!(expect_room(folder.path(), u64::MAX, false).is_err());
    }
}
