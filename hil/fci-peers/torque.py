"""A pylibfranka loop with the torque that plumbline identifies while it listens, against the emulator: called by torque.sh."""

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUILT = ROOT / "target/debug"
ADDRESS = "127.0.43.1"
# Goals: error on unseen motion as a ratio to the noise of a sample, and tracking error without to that with the torque.
MAX_NOISE_RATIO, MIN_TRACKING_RATIO = 1.05, 5.0


def noise():
    """Standard deviation of a torque sample of the emulator's arm, with its rounding, per joint [Nm]."""
    with open(ROOT / "config/arms/sim-panda.toml", "rb") as file:
        joints = tomllib.load(file)["joint"]
    return [math.hypot(joint["torque-noise"], joint.get("torque-quantum", 0.0) / math.sqrt(12)) for joint in joints]


def listed(values, digits):
    return " ".join(f"{value:.{digits}f}" for value in values)


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--seconds", type=float, default=120.0, help="length of the loop's motion [s] (default: %(default)s)")
    arguments.add_argument("--command-wait", type=int, default=100, help="emulator: longest wait for a command [ms] (default: %(default)s)")
    options = arguments.parse_args()
    place = tempfile.TemporaryDirectory(prefix="plumbline-torque-")
    out, robot = Path(place.name) / "out", f"pylibfranka-{os.getpid()}"
    times = {"identify": options.seconds / 3, "validate": options.seconds / 6, "run": options.seconds / 6}
    sets = [f"serve.id={robot}", "mounting=upright", *(f"backend.guest.{key}={value} s" for key, value in times.items())]
    emulator = [BUILT / "examples/fci-emulator", "--address", ADDRESS, "--command-wait", str(options.command_wait)]
    plumbline = [BUILT / "plumbline", "run", "config/guest.toml", "--out", out, *(word for one in sets for word in ("--set", one))]
    example = ["examples/clients/python/pylibfranka_torque.py", "--address", ADDRESS, "--robot", robot]
    example += ["--seconds", str(options.seconds), "--rotor-inertia", "0.1"]

    with open(Path(place.name) / "emulator.log", "w+") as log:
        arm = subprocess.Popen(emulator, cwd=ROOT, stdin=subprocess.PIPE, stderr=log)
        listener = subprocess.Popen(plumbline, cwd=ROOT)
        try:
            time.sleep(1.0)
            if arm.poll() is not None or listener.poll() is not None:
                log.seek(0)
                sys.exit(f"the emulator or plumbline ended at once: {log.read()}")
            loop = subprocess.run([sys.executable, "-u", *example], cwd=ROOT, stdout=subprocess.PIPE, text=True)
            print(loop.stdout, end="", flush=True)
            code = listener.wait(timeout=600)
        finally:
            arm.kill()
            listener.terminate()
    if loop.returncode != 0 or code != 0:
        sys.exit(f"the loop ended with status {loop.returncode}, plumbline with status {code}")
    report = json.loads((out / "report.json").read_text())
    counts = report["guest"]
    print("states:", ", ".join(f"{name} {count}" for name, count in counts.items() if count))
    floor, ratios = noise(), []
    for run in report["validate"]:
        ratios.append(sum(run["rms_raw"]) / sum(floor))
        print(f"{run['run']}: error {listed(run['rms_raw'], 3)} Nm, {ratios[-1]:.3f} of the noise")
    tracking = [float(word) for word in loop.stdout.rpartition("ratio: ")[2].split()]
    missed = []
    if not ratios or max(ratios) > MAX_NOISE_RATIO:
        missed.append(f"error on unseen motion {listed(ratios, 3)} of the noise, goal {MAX_NOISE_RATIO}")
    if min(tracking) < MIN_TRACKING_RATIO:
        missed.append(f"tracking error {listed(tracking, 1)} times smaller, goal {MIN_TRACKING_RATIO}")
    sys.exit("; ".join(missed) or None)


main()
