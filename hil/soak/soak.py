"""Starts the daemon, the load and cyclictest, samples the daemon's memory and descriptors, and holds the end against the promises."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time

RECORD_BYTES = 672          # one record of the daemon's replay log (`SampleMessage`)
RETAINED = 600_000          # records that it keeps
FLAT_KIB = 4096             # growth of memory, the replay log apart, that still counts as flat


def field(pid, name):
    with open(f"/proc/{pid}/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith(name + ":"))


def descriptors(pid):
    return len(os.listdir(f"/proc/{pid}/fd"))


def command(program, what, robot):
    return subprocess.run([program, "command", what, "--json", "--robot", robot], capture_output=True, text=True)


def sample(pid, begin, published):
    """Seconds, memory without what the replay log is known to hold [KiB], file descriptors, threads."""
    log_kib = min(published, RETAINED) * RECORD_BYTES // 1024
    return time.monotonic() - begin, field(pid, "VmRSS") - log_kib, descriptors(pid), field(pid, "Threads")


def cyclictest(seconds):
    arguments = ["cyclictest", "--quiet", "--mlockall", "--threads=1", "--interval=1000", "--histogram=100000"]
    asked = arguments + ["--priority=81", f"--duration={seconds}"]
    return subprocess.Popen(asked, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)


def quantiles(text):
    """p50, p99, p99.9 and max of a histogram of cyclictest [us]."""
    counts = [(int(m[1]), int(m[2])) for m in re.finditer(r"^(\d{6}) (\d+)$", text, re.M)]
    total = sum(count for _, count in counts)
    most = re.search(r"^# Max Latencies: (\d+)", text, re.M)
    if not total or not most:
        return None
    out, seen, wanted = [], 0, [0.5, 0.99, 0.999]
    for us, count in counts:
        seen += count
        while wanted and seen >= wanted[0] * total:
            out.append(float(us))
            wanted.pop(0)
    return out + [float(most[1])] * (len(wanted) + 1)


def main():
    program, seconds = sys.argv[1], int(sys.argv[2])
    robot = f"soak-{os.getpid()}"
    place = tempfile.mkdtemp(prefix="plumbline-soak-")
    periods = min(1000, seconds // 4 + 1)
    sets = [
        f"serve.id={robot}", "backend.arm=arms/sim-panda.toml", "backend.pace=wall-clock", "safety.max-lost=1000",
        "excitation.trajectories=1", "excitation.period=4 s", f"excitation.periods={periods}", "excitation.starts=1",
        "excitation.rounds=0", "validation.trajectories=1", "validation.counter-experiment=false",
    ]
    arguments = [program, "daemon", "config/sim-panda-wall.toml", "--out", place]
    log = open(os.path.join(place, "daemon.log"), "w+")
    daemon = subprocess.Popen(arguments + [x for s in sets for x in ("--set", s)], stderr=log)
    helpers, problems, samples = [], [], []
    try:
        for _ in range(600):
            if command(program, "status", robot).returncode == 0:
                break
            time.sleep(0.2)
        else:
            sys.exit("the daemon did not come up")
        assert command(program, "start", robot).returncode == 0
        time.sleep(3)
        helpers.append(subprocess.Popen(
            ["stress-ng", "--cpu", "2", "--vm", "1", "--vm-bytes", "256M", "--hdd", "1", "--hdd-bytes", "64M", "--temp-path", place,
             "--timeout", f"{seconds + 30}s", "--quiet"]))
        measuring = cyclictest(seconds)
        helpers.append(measuring)
        begin = time.monotonic()
        step = max(5, seconds // 60)
        while time.monotonic() - begin < seconds:
            if daemon.poll() is not None:
                problems.append(f"the daemon ended with {daemon.returncode} in the middle, after {time.monotonic() - begin:.0f} s")
                # It prints what it has counted so far.
                measuring.terminate()
                break
            answer = command(program, "status", robot)
            if answer.returncode == 0:
                published = json.loads(answer.stdout)["served"]["published"]
                samples.append(sample(daemon.pid, begin, published))
            time.sleep(step)
        histogram = measuring.communicate(timeout=60)[0]
    finally:
        for helper in helpers:
            if helper.poll() is None:
                helper.terminate()
        if daemon.poll() is None:
            daemon.send_signal(signal.SIGTERM)
    code = daemon.wait(timeout=60)
    log.seek(0)
    text = log.read()
    judge(text, code, samples, quantiles(histogram), problems)
    shutil.rmtree(place, ignore_errors=True)


def judge(text, code, samples, beside, problems):
    if code != 0:
        problems.append(f"the daemon's exit code is {code}:\n{text[-2000:]}")
    sessions = re.findall(
        r"session `(.*?)`: (\d+) periods (.*?) (\d+) cycles \+ (\d+) skipped \(longest run (\d+)\), (\d+) by this machine's clock; "
        r"(\d+) late, (\d+) dropped records, (\w+) allocations; wake-up p50 ([\d.]+) p99 ([\d.]+) p99.9 ([\d.]+) max ([\d.]+) us; "
        r"execution p50 ([\d.]+) p99 ([\d.]+) p99.9 ([\d.]+) max ([\d.]+) us", text)
    if not sessions:
        problems.append("the daemon accounted for no session")
    for name, period, sign, cycles, skipped, longest, clock, late, lost, allocations, *times in sessions:
        print(f"session {name}: {period} periods = {cycles} cycles + {skipped} skipped (longest run {longest}), {clock} by the clock, "
              f"{late} late, {lost} dropped records, {allocations} allocations")
        print(f"    execution p50 {times[4]} p99 {times[5]} p99.9 {times[6]} max {times[7]} us")
        if sign != "=" or int(period) != int(cycles) + int(skipped) or period != clock:
            problems.append(f"session {name}: not every period is accounted for")
        if lost != "0" or allocations != "0":
            problems.append(f"session {name}: {lost} dropped records, {allocations} allocations")
    if sessions and beside:
        longest_session = max(sessions, key=lambda s: int(s[1]))
        ours = [float(x) for x in longest_session[10:14]]
        print(f"wake-up        p50 {ours[0]:8.1f} p99 {ours[1]:8.1f} p99.9 {ours[2]:8.1f} max {ours[3]:8.1f} us")
        print(f"cyclictest     p50 {beside[0]:8.1f} p99 {beside[1]:8.1f} p99.9 {beside[2]:8.1f} max {beside[3]:8.1f} us")
        print("ratio          " + " ".join(f"{n} {a / max(b, 1):8.2f}" for n, a, b in zip(["p50", "p99", "p99.9", "max"], ours, beside)))
    # The first tenth is the daemon's warming up.
    steady = samples[len(samples) // 10 + 1:]
    if len(steady) < 4:
        problems.append("too few samples of memory and descriptors")
    else:
        half = len(steady) // 2
        early, late = (min(s[1] for s in part) for part in (steady[:half], steady[half:]))
        fds = {s[2] for s in steady}
        print(f"memory without the replay log: {early} KiB, then {late} KiB; file descriptors {min(fds)} to {max(fds)}; "
              f"threads {min(s[3] for s in steady)} to {max(s[3] for s in steady)}; {len(samples)} samples")
        if late - early > FLAT_KIB:
            problems.append(f"memory grows: {early} KiB, then {late} KiB")
        # A command that is being answered has its own for a moment.
        if min(s[2] for s in steady[half:]) > min(s[2] for s in steady[:half]):
            problems.append("file descriptors grow")
    for line in sorted(set(re.findall(r"degraded, not real-time: .*", text))):
        print(line)
    for problem in problems:
        print("PROBLEM:", problem)
    print("held" if not problems else "NOT HELD")
    sys.exit(1 if problems else 0)


main()
