"""The wheel of crates/python, from a user's view. hil/python/run.sh builds it, and the two programs of this repository that it is compared with."""

import hashlib
import inspect
import json
import os
import re
import signal
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import plumbline
from plumbline import errors

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "target/debug/plumbline"
PEER = ROOT / "target/debug/examples/python-peer"
EXPECTED = ROOT / "target/python/peer"
PAPER_MODEL = ROOT / "config/models/panda-paper-table3.toml"
WALL = plumbline.gravity("wall")

# The shipped job with one short motion.
SHORT = [
    "backend.arm=arms/sim-panda.toml",
    "excitation.trajectories=1",
    "excitation.period=4 s",
    "excitation.periods=3",
    "excitation.starts=1",
    "excitation.rounds=0",
    "validation.trajectories=1",
    "validation.counter-experiment=false",
    "diagnosis.enabled=false",
]
HOLD = ["backend.pace=wall-clock", "safety.max-lost=1000", "realtime.lock-memory=false"]


def arguments(subcommand, job, out, sets):
    command = [str(PROGRAM), subcommand, str(ROOT / job), "--out", str(out)]
    for one in sets:
        command += ["--set", one]
    return command


def run(*command, code=0):
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == code, done.stderr
    return done


def within(seconds, what, attempt):
    """What `attempt` returns when it is true for the first time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := attempt():
            return found
        time.sleep(0.01)
    raise AssertionError(f"no {what} within {seconds} s")


@pytest.fixture(scope="session")
def job(tmp_path_factory):
    """Results of `plumbline run` in simulated time, with the recorded dataset."""
    out = tmp_path_factory.mktemp("job") / "out"
    run(*arguments("run", "config/sim-panda-wall.toml", out, [*SHORT, f"serve.id=python-job-{os.getpid()}"]))
    return out


def without_date(text):
    return re.sub(r'("?date"?\s*[:=]\s*)"[^"]*"', r"\1", text)


@pytest.mark.parametrize("robot", sorted(path.stem for path in (ROOT / "config/robots").glob("*.toml")))
def test_torques_are_those_of_rust_bit_for_bit(robot):
    model = plumbline.Model.load(EXPECTED / f"{robot}.toml", [9.81, 0.0, 0.0])
    n = model.joints
    q, dq, ddq = np.fromfile(EXPECTED / f"{robot}.states").reshape(10_000, 3, n).transpose(1, 0, 2)
    expected = np.fromfile(EXPECTED / f"{robot}.torques").reshape(10_000, n)
    assert model.torque(q, dq, ddq).tobytes() == expected.tobytes()
    one_by_one = np.array([model.torque(*state) for state in zip(q[:200], dq[:200], ddq[:200])])
    assert one_by_one.tobytes() == expected[:200].tobytes()


def test_the_parts_of_a_model_fit_together():
    model = plumbline.Model.load(PAPER_MODEL, WALL)
    rng = np.random.default_rng(1)
    q, dq, ddq = rng.uniform(-1, 1, (3, 50, 7))
    tau = model.torque(q, dq, ddq)
    inertia = model.inertia(q)
    assert inertia.shape == (50, 7, 7)
    parts = np.einsum("kij,kj->ki", inertia, ddq) + model.coriolis(q, dq) + model.gravity(q) + model.friction(dq)
    assert np.abs(parts - tau).max() < 1e-9
    y = model.regressor(q, dq, ddq)
    assert y.shape == (50, 7, model.columns) and model.regressor(q[0], dq[0], ddq[0]).shape == (7, model.columns)
    beta = np.linalg.lstsq(y.reshape(-1, model.columns), tau.reshape(-1), rcond=None)[0]
    assert np.abs(y @ beta - tau).max() < 1e-9
    upright = plumbline.Model.load(PAPER_MODEL, plumbline.gravity("upright")).torque(q, dq, ddq)
    assert np.array_equal(model.torque(q, dq, ddq, plumbline.gravity("upright")), upright)
    # Whatever numpy makes an array of.
    assert np.array_equal(model.torque([0] * 7, (0.0,) * 7, np.zeros(7, np.float32)), model.torque(*np.zeros((3, 7))))
    with pytest.raises(errors.NoUncertainty, match="has no \\[uncertainty\\]"):
        model.torque_std(q, dq, ddq)


def test_an_identification_is_that_of_the_command_line(job, tmp_path):
    dataset = job / "dataset"
    out = tmp_path / "cli"
    run(PROGRAM, "identify", dataset, "--out", out, "--torque-cutoff", "6", "--essential")
    results = plumbline.identify(dataset, torque_cutoff=6.0, essential=True)
    assert without_date(results.model_toml) == without_date((out / "model.toml").read_text())
    expected = json.loads(without_date((out / "report.json").read_text()).replace('"date": ', '"date": ""'))
    results.report["provenance"]["date"] = expected["provenance"]["date"] = ""
    assert expected["provenance"].pop("command").startswith("plumbline identify")
    assert results.report == expected
    assert "<iframe" in results._repr_html_() and "&lt;!doctype html&gt;" in results._repr_html_().lower()
    # The model is that of the results, in the mounting of the dataset.
    assert np.allclose(results.gravity, WALL, atol=1e-12)
    assert results.model.torque_std(*np.zeros((3, 7))).shape == (7,)
    folder = results.folder
    del results
    assert not folder.exists()
    kept = plumbline.identify(dataset, out=tmp_path / "kept")
    assert kept.report == plumbline.Results(tmp_path / "kept").report and (tmp_path / "kept/report.html").is_file()


def test_a_prediction_and_a_comparison_are_those_of_the_command_line(job, tmp_path):
    model = job / "model.toml"
    recorded = next((job / "dataset").glob("*.csv"))
    run(PROGRAM, "predict", model, recorded, "--out", tmp_path / "tau.csv")
    table = np.genfromtxt(tmp_path / "tau.csv", delimiter=",", names=True)
    prediction = plumbline.predict(model, recorded)
    assert np.array_equal(prediction.t, table["t"]) and np.array_equal(prediction.at_end, table["at_end"] == 1)
    for j in range(7):
        assert np.array_equal(prediction.tau[:, j], table[f"tau{j + 1}"])
        assert np.array_equal(prediction.low[:, j], table[f"tau{j + 1}_low"])
    assert prediction.rms_raw.shape == (7,) and 0.9 < prediction.coverage.mean() < 1
    assert prediction.external is None
    run(PROGRAM, "compare", model, job / "dataset", "--out", tmp_path / "cli")
    compared = plumbline.compare(model, job / "dataset")
    assert compared.report["diagnosis"] == json.loads((tmp_path / "cli/report.json").read_text())["diagnosis"]
    assert compared.report["diagnosis"]["verdict"] in repr(compared)


def test_an_external_torque_is_that_of_the_command_line(job, tmp_path):
    model = job / "model.toml"
    recorded = next((job / "dataset").glob("identify*.csv"))
    # A push of 8 Nm on joint 2 for half a second.
    table = np.genfromtxt(recorded, delimiter=",", names=True)
    begin = table["t"][0] + 2.0
    table["tau2"][(begin <= table["t"]) & (table["t"] < begin + 0.5)] += 8.0
    pushed = tmp_path / "pushed.csv"
    np.savetxt(pushed, table, delimiter=",", header=",".join(table.dtype.names), comments="", fmt="%.17g")
    options = ["--external", "--bandwidth", "10", "--false-alarms", "0.2", "--by", "momentum", "--mounting", "wall"]
    printed = run(PROGRAM, "predict", model, pushed, "--out", tmp_path / "tau.csv", *options).stdout
    table = np.genfromtxt(tmp_path / "tau.csv", delimiter=",", names=True)
    found = plumbline.predict(
        model, pushed, mounting="wall", external=True, bandwidth=10, false_alarms=0.2, by="momentum"
    ).external
    assert np.array_equal(found.contact, table["contact"] == 1)
    for j in range(7):
        for values, name in [(found.tau, ""), (found.low, "_low"), (found.high, "_high")]:
            assert np.array_equal(values[:, j], table[f"tau_ext{j + 1}{name}"])
    assert found.thresholds.shape == (7,) and found.wrench_thresholds.shape == (6,)
    assert ", ".join(f"{one:.3f}" for one in found.thresholds) in printed and f"{1e3 * found.delay:.1f} ms late" in printed
    (contact,) = [one for one in found.contacts if 2 in one.joints]
    assert begin < contact.begin < begin + 0.1 < contact.end and 6 < contact.torque[1] < 10
    with pytest.raises(plumbline.InputError, match="--external"):
        plumbline.predict(model, pushed, bandwidth=10)


def test_a_diagnosis_is_that_of_the_command_line(job, tmp_path):
    run(PROGRAM, "diagnose", job / "dataset", "--out", tmp_path / "cli")
    diagnosed = plumbline.diagnose(job / "dataset")
    assert diagnosed.report["diagnosis"] == json.loads((tmp_path / "cli/report.json").read_text())["diagnosis"]


def test_planned_motions_are_those_of_the_command_line(tmp_path):
    few = ["--trajectories", "2", "--validate", "1", "--starts", "1", "--rounds", "0", "--period", "4"]
    run(PROGRAM, "plan", "--robot", "panda", "--mounting", "wall", "--out", tmp_path / "plan.toml", *few)
    motions = plumbline.plan("panda", mounting="wall", trajectories=2, validate=1, starts=1, rounds=0, period=4)
    files = ["plan-1.toml", "plan-2.toml", "plan-validate-1.toml"]
    assert [motion.toml for motion in motions] == [(tmp_path / file).read_text() for file in files]
    assert [motion.validates for motion in motions] == [False, False, True]
    motion = motions[0]
    t = np.arange(0, 4, 1e-3)
    q, dq, ddq = motion.at(t)
    assert q.shape == (4000, 7) and np.allclose(motion.at([0.0])[0], motion.at([motion.period])[0])
    assert np.abs(np.gradient(q, t, axis=0) - dq)[1:-1].max() < 1e-4
    assert np.abs(np.gradient(dq, t, axis=0) - ddq)[1:-1].max() < 1e-3
    motion.save(tmp_path / "again.toml")
    again = plumbline.Motion.load(tmp_path / "again.toml")
    assert again.toml == motion.toml and again.report["robot"] == "panda" and again.report["q0"] == motion.report["q0"]


def test_options_are_those_of_the_command_line():
    # Arrays and objects are returned instead of files and console output.
    results = {"verbose", "quiet", "json", "open", "force"}
    elsewhere = {
        "identify": results,
        "diagnose": results,
        "compare": results,
        "predict": {"out"},
        "plan": {"out", "of", "csv", "ros", "rate", "periods", "joint-names", "json", "page"},
    }
    for name, others in elsewhere.items():
        printed = run(PROGRAM, name, "--help").stdout
        options = set(re.findall(r"--([a-z-]+)", "\n".join(re.findall(r"^ +(?:-., )?--.*$", printed, re.M)))) - {"help"}
        known = {one.replace("_", "-") for one in inspect.signature(getattr(plumbline, name)).parameters}
        assert options - known == others, (name, options - known)


def test_bad_input_has_the_text_of_the_command_line(job, tmp_path):
    def text(*command):
        return run(PROGRAM, *command, code=2).stderr.strip().removeprefix("plumbline: ").removeprefix("error: ")

    dataset, out = job / "dataset", tmp_path / "out"
    broken = tmp_path / "broken.toml"
    broken.write_text("kind = 7\n")
    cases = [
        (lambda: plumbline.identify(tmp_path), ["identify", tmp_path, "--out", out]),
        (lambda: plumbline.identify(dataset, trim=-1), ["identify", dataset, "--out", out, "--trim=-1"]),
        (lambda: plumbline.identify(dataset, estimator="best"), ["identify", dataset, "--out", out, "--estimator=best"]),
        (lambda: plumbline.diagnose(dataset, band=1e9), ["diagnose", dataset, "--out", out, "--band", "1e9"]),
        (lambda: plumbline.compare(broken, dataset), ["compare", broken, dataset, "--out", out]),
        (lambda: plumbline.predict(broken, broken), ["predict", broken, broken, "--out", out]),
        (lambda: plumbline.plan("nobody"), ["plan", "--robot", "nobody", "--out", out]),
        (lambda: plumbline.plan("panda", mounting="askew"), ["plan", "--robot", "panda", "--mounting", "askew", "--out", out]),
    ]
    for call, command in cases:
        with pytest.raises(plumbline.InputError) as raised:
            call()
        assert str(raised.value) in text(*command), command
        parts = [getattr(raised.value, part) for part in ("file", "place", "value", "expected")]
        assert all(part in str(raised.value) for part in parts), parts
    with pytest.raises(plumbline.InputError, match="invalid value 'many'"):
        plumbline.plan("panda", starts="many")
    with pytest.raises(TypeError):
        plumbline.identify(dataset, trimm=1)
    with pytest.raises(plumbline.InputError, match="a readable model file"):
        plumbline.Model.load(tmp_path / "none.toml", WALL)
    with pytest.raises(errors.NoDaemon, match="waited 0 ms"):
        plumbline.Model.follow("nobody", timeout=0)
    with pytest.raises(plumbline.InputError):
        plumbline.FeedForward("No Robot")
    for joints in [0, 9]:
        with pytest.raises(plumbline.InputError, match="1 to 8"):
            plumbline.Guest("python-bad", joints)


def test_bad_states_are_refused_by_name():
    model = plumbline.Model.load(PAPER_MODEL, WALL)
    good = np.zeros(7)
    states = np.zeros((3, 7))
    states[2, 4] = np.nan
    with pytest.raises(errors.NotFinite, match="row 2: a number of the input is not finite"):
        model.torque(states, np.zeros((3, 7)), np.zeros((3, 7)))
    with pytest.raises(errors.LengthError, match="6 entries, expected 7"):
        model.torque(*np.zeros((3, 6)))
    with pytest.raises(errors.LengthError, match="dq has shape"):
        model.torque(good, np.zeros(6), good)
    with pytest.raises(errors.LengthError, match="q has shape"):
        model.gravity(np.zeros((2, 2, 7)))
    with pytest.raises(errors.LengthError, match="gravity has 2 values, expected 3"):
        model.torque(good, good, good, [1.0, 2.0])
    with pytest.raises(errors.LengthError):
        model.gravity([])
    with pytest.raises(ValueError):
        model.gravity("text")
    assert model.torque(*np.zeros((3, 0, 7))).shape == (0, 7)
    with pytest.raises(errors.NotFinite):
        plumbline.Guest(f"python-nan-{os.getpid()}", 7).publish(good, good, np.full(7, np.inf), good)
    with pytest.raises(errors.OtherMounting, match="finite"):
        plumbline.Model.load(PAPER_MODEL, [np.nan, 0, 0])
    assert issubclass(errors.NotFinite, plumbline.Error)


def test_other_threads_run_while_something_is_computed(job):
    ended = threading.Event()
    spent = []

    def work():
        begin = time.monotonic()
        plumbline.identify(job / "dataset")
        spent.append(time.monotonic() - begin)
        ended.set()

    thread = threading.Thread(target=work)
    thread.start()
    last, longest = time.monotonic(), 0.0
    while not ended.is_set():
        time.sleep(0.001)
        longest, last = max(longest, time.monotonic() - last), time.monotonic()
    thread.join()
    assert longest < 0.5 * spent[0], (longest, spent)


def test_ctrl_c_ends_a_search():
    # A shell starts background jobs with SIGINT ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(1.0, signal.raise_signal, [signal.SIGINT])
    timer.start()
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        plumbline.plan("panda", seconds=60)
    assert time.monotonic() - begin < 50
    # Python's own handler is in place still.
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_the_model_and_the_torque_of_a_daemon_are_followed(tmp_path):
    robot = f"python-follow-{os.getpid()}"
    command = arguments("daemon", "config/sim-panda-wall.toml", tmp_path / "out", [*SHORT, *HOLD, f"serve.id={robot}"])
    with subprocess.Popen([*command, "--model", str(PAPER_MODEL)], cwd=ROOT, stderr=subprocess.DEVNULL) as daemon:
        try:
            with pytest.raises(errors.OtherRobot, match="expected `fr3`"):
                other = plumbline.Model.follow(robot, expected_robot="fr3", timeout=30)
                assert other.status().model == 0
                other.check_daemon()
            model = plumbline.Model.follow(robot, expected_robot="panda", expected_gravity=WALL, timeout=30)
            model.check_daemon()
            status = model.status()
            identity = int.from_bytes(hashlib.sha256(PAPER_MODEL.read_bytes()).digest()[:8], "big")
            assert (status.validity, status.model) == ("valid", identity) and status.age < 5
            own = plumbline.Model.load(PAPER_MODEL, WALL)
            q = np.linspace(-1, 1, 7)
            assert np.array_equal(model.torque(q, q, q), own.torque(q, q, q))

            feed_forward = plumbline.FeedForward(robot, stale_after=10.0, timeout=30)
            first = within(30, "usable torque", lambda: (found := feed_forward.latest()) and found.usable and found)
            # A torque is usable while the model is handed over, too.
            handed_over = lambda found: found.sequence > first.sequence and found.validity != "hand-over"
            later = within(30, "later value", lambda: handed_over(found := feed_forward.latest()) and found)
            assert (later.model, later.validity, later.phase, later.epoch) == (identity, "valid", "hold", first.epoch)
            assert later.age < 5 and not later.stale and feed_forward.running
            # At rest.
            assert np.abs(later.tau - own.gravity(later.q_d)).max() < 1e-9 and np.abs(later.dq_d).max() == 0
            assert np.allclose(later.gravity, WALL) and f"sequence={later.sequence}" in repr(later)
            found = []
            thread = threading.Thread(target=lambda: found.append(feed_forward.latest().sequence))
            thread.start()
            thread.join()
            assert found[0] >= later.sequence

            daemon.kill()
            daemon.wait()
            with pytest.raises(errors.DaemonGone, match="has ended, or sends nothing; the last model is kept"):
                within(30, "end", model.check_daemon)
            assert np.array_equal(model.torque(q, q, q), own.torque(q, q, q))
            assert not feed_forward.running
        finally:
            daemon.kill()


def test_published_states_reach_the_daemon(tmp_path):
    robot = f"python-guest-{os.getpid()}"
    sets = [f"serve.id={robot}", "mounting=wall"]
    command = arguments("run", "config/guest.toml", tmp_path / "out", sets)
    model = plumbline.Model.load(PAPER_MODEL, WALL)
    t = np.arange(0, 3, 1e-3)[:, None]
    w = 1.0 + 0.3 * np.arange(7)
    q, dq, ddq = 0.4 * np.sin(w * t), 0.4 * w * np.cos(w * t), -0.4 * w**2 * np.sin(w * t)
    tau = model.torque(q, dq, ddq)

    def status():
        done = subprocess.run([PROGRAM, "command", "status", "--json", "--robot", robot], capture_output=True, text=True)
        return json.loads(done.stdout).get("guest") if done.returncode == 0 else None

    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL) as daemon:
        try:
            within(60, "daemon", status)
            guest = plumbline.Guest(robot, 7)
            with pytest.raises(errors.SecondPublisher):
                plumbline.Guest(robot, 7)
            begin = time.monotonic()
            for k in range(len(t)):
                guest.publish(q[k], dq[k], tau[k], q[k])
                time.sleep(max(0.0, begin + 1e-3 * (k + 1) - time.monotonic()))
            lost = guest.lost
            # A loaded machine may lose some; each is counted on one side.
            arrived = within(30, "all states", lambda: (now := status()) and now["received"] + now["lost"] >= len(t) and now)
            assert arrived["received"] + arrived["lost"] == len(t) and arrived["publishers"] == 1
            assert arrived["received"] > len(t) / 2 and arrived["not_finite"] == arrived["malformed"] == arrived["other_joints"] == 0
        finally:
            daemon.terminate()


@pytest.mark.parametrize("other", ["types", "number"])
def test_messages_of_another_layout_are_refused_by_name(other):
    robot = f"python-layout-{os.getpid()}"
    with subprocess.Popen([PEER, "layout", robot, other], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as daemon:
        assert daemon.stdout.readline() == b"serves\n"
        with pytest.raises(errors.Incompatible):
            # The daemon sends what it has when it sees the new subscriber.
            model = plumbline.Model.follow(robot, timeout=1)
            within(5, "error", model.check_daemon)
        if other == "types":
            with pytest.raises(errors.Incompatible):
                plumbline.FeedForward(robot, timeout=1)
            with pytest.raises(errors.Incompatible):
                plumbline.Guest(robot, 7)
        daemon.stdin.close()
        assert daemon.wait(30) == 0
