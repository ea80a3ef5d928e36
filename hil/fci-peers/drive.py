"""Lets clients of other origin drive the emulator, and writes down what each of them did.

    drive.py EMULATOR --library FILE --venvs FOLDER --table FILE

is called by run.sh, which makes the environments. Standard library alone."""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

HERE = Path(__file__).parent

# Program with its version, libfranka inside, script, environment, protocol version.
PROGRAMS = [
    ("panda-python 1.1.1", "0.9.2", "panda_python.py", "libfranka-0.9", 5),
    ("franky-control 1.1.2", "0.15.3", "franky_client.py", "libfranka-0.15", 9),
    ("pylibfranka 0.21.3", "0.21.3", "pylibfranka_client.py", "libfranka-0.21", 10),
    ("franky-control 2.0.0", "0.21.2", "franky_client.py", "libfranka-0.21", 10),
    ("franka-rs 0.4.0", "none", "franka_rs_client.py", "franka-rs", 5),
    ("franka-rs 0.4.0", "none", "franka_rs_client.py", "franka-rs", 10),
]


class Emulator:
    """One emulator, on an address of its own."""

    def __init__(self, program, address, protocol, library, command_wait):
        command = [program, "--address", address, "--protocol", str(protocol), "--model-library", library]
        command += ["--command-wait", str(command_wait)]
        self.address = address
        self.log = tempfile.TemporaryFile("w+")
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=self.log, text=True)
        time.sleep(0.5)
        if self.process.poll() is not None:
            raise SystemExit(f"the emulator ended at once: {self.said()}")

    def do(self, order):
        self.process.stdin.write(order + "\n")
        self.process.stdin.flush()

    def said(self):
        self.log.seek(0)
        return self.log.read()

    def end(self):
        self.process.stdin.close()
        self.process.kill()
        self.process.wait()


def run(python, script, emulator, other):
    """Runs one program to its end; its cells by name, and what it left on standard error."""
    cells = {}
    # -u: lines come when they are printed. A hang is a result, too.
    command = [python, "-u", str(HERE / script), emulator.address, other.address]
    program = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=HERE, env=dict(os.environ)
    )
    errors = []
    reader = threading.Thread(target=lambda: errors.append(program.stderr.read()))
    reader.start()
    limit = threading.Timer(240, program.kill)
    limit.start()
    for line in program.stdout:
        word, _, rest = line.strip().partition(" ")
        if word == "DO":
            emulator.do(rest)
        elif word == "CELL":
            cell = json.loads(rest)
            cells[cell["cell"]] = cell
            print(f"    {cell['cell']}: {'' if cell['good'] else 'FAILED: '}{cell['text']}", flush=True)
    status = program.wait()
    limit.cancel()
    reader.join()
    if status != 0:
        last = errors[0].strip().splitlines()[-1:] or [""]
        cells["end"] = {"cell": "end", "good": False, "text": f"the program ended with status {status}: {last[0]}"}
        print(f"    FAILED: status {status}\n{errors[0]}", flush=True)
    return cells


# What is refused by name has a table of its own.
REFUSED = [
    "jump",
    "wrong start",
    "too fast",
    "out of range",
    "torque step",
    "torque range",
    "collision",
    "stall",
    "commands lost",
]


def table(results):
    """Markdown of all results: programs by rows, what they did by columns."""
    columns = []
    for _, cells in results:
        columns += [name for name in cells if name not in columns]
    done = [name for name in columns if name not in REFUSED]
    return "\n\n".join(part(results, some) for some in [done, [name for name in columns if name in REFUSED]])


def part(results, columns):
    head = ["program", "libfranka inside", "version"] + columns
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for (name, inside, _, _, protocol), cells in results:
        row = [name, inside, str(protocol)]
        for column in columns:
            cell = cells.get(column)
            text = "-" if cell is None else cell["text"]
            row.append(("" if cell is None or cell["good"] else "**failed**: ") + text.replace("|", "\\|"))
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines)


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("emulator")
    arguments.add_argument("--library", required=True)
    arguments.add_argument("--venvs", required=True, help="folder of the environments, venv-NAME each")
    arguments.add_argument("--table", help="Markdown file whose part between the two marks is replaced")
    arguments.add_argument("--only", help="part of a program's name")
    arguments.add_argument("--command-wait", type=int, default=0)
    options = arguments.parse_args()
    results = []
    for number, program in enumerate(PROGRAMS):
        name, _, script, venv, protocol = program
        if options.only and options.only not in f"{name} {script} version {protocol}":
            continue
        print(f"{name}, protocol version {protocol}", flush=True)
        other = 10 if protocol != 10 else 9
        python = f"{Path(options.venvs).absolute()}/venv-{venv}/bin/python"
        served = [
            Emulator(options.emulator, f"127.0.42.{2 * number + k + 1}", version, options.library, options.command_wait)
            for k, version in enumerate([protocol, other])
        ]
        try:
            results.append((program, run(python, script, *served)))
        finally:
            for emulator in served:
                emulator.end()
        if any(not cell["good"] for cell in results[-1][1].values()):
            print(served[0].said()[-6000:], file=sys.stderr)
    if options.table:
        path = Path(options.table)
        begin, end = "<!-- run.sh writes from here -->", "<!-- to here -->"
        text = path.read_text()
        before, rest = text.split(begin)
        path.write_text(before + begin + "\n\n" + table(results) + "\n\n" + end + rest.split(end)[1])
    sys.exit(any(not cell["good"] for _, cells in results for cell in cells.values()))


main()
