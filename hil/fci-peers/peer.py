"""What the programs here share: cells of the table, tries, trajectories, and the line to whoever holds the emulator.

A program is called with the address of an emulator and of a second one that speaks another version. It prints `CELL` lines with one
JSON object each, and `DO` lines that ask for the operator's hand or a fault (see the emulator's `help`)."""

import json
import os
import re
import sys
import time

ADDRESS = sys.argv[1]
OTHER = sys.argv[2] if len(sys.argv) > 2 else None
# How long a stall is that no robot forgives: the emulator's command wait may make it longer.
STALL = float(os.environ.get("FCI_STALL", "0.06"))
# This is no real-time machine: lost commands are its fault, and end a motion rightly. Then the exercise is tried again.
TRIES = int(os.environ.get("FCI_TRIES", "8"))
LOST = "communication_constraints_violation"
# Fewer of them are a jump in what arrives; libfranka says how many arrived.
RATE = re.compile(r"control_command_success_rate: ([0-9.]+)")
READY = [0.0, -0.7853981633974483, 0.0, -2.356194490192345, 0.0, 1.5707963267948966, 0.7853981633974483]

NAME = re.compile(
    r"\b(?:[a-z]+_)+(?:violation|reflex|invalid|discontinuity|inconsistent|detected|direction|planning|flag)\b"
    r"|tau_J_range_violation"
)


def do(order):
    """The operator's hand, or the network's."""
    print("DO " + order, flush=True)
    time.sleep(0.15)


def tell(cell, good, text):
    print("CELL " + json.dumps({"cell": cell, "good": good, "text": text}), flush=True)


def names(error):
    """Robot errors in the text of an exception."""
    found = []
    for name in NAME.findall(str(error)):
        if name not in found:
            found.append(name)
    return found


def cell(name, action, recover=None):
    """Fills a cell with what `action` returns; an error fills it, too, and is no success."""
    before = ""
    for attempt in range(1, TRIES + 1):
        try:
            text = action() or "yes"
            tell(name, True, text if attempt == 1 else f"{text} (try {attempt}; commands were lost before: {before})")
            return True
        except Exception as error:  # whatever a binding throws is what the cell says
            rate = RATE.search(str(error))
            lost = LOST in str(error) or (rate is not None and float(rate[1]) < 1.0)
            if lost and recover is not None and attempt < TRIES:
                before = ", ".join(names(error)) + (f" at a success rate of {rate[1]}" if rate else "")
                recover()
                continue
            why = " ".join(f"{type(error).__name__}: {error}".split())
            tell(name, False, why[:300])
            if recover is not None:
                try:
                    recover()
                except Exception as second:
                    print(f"recovery: {second}", file=sys.stderr)
            return False


def refused(action, expected):
    """Runs `action`, which has to be refused with `expected` in the error's text; returns the names in it."""
    try:
        action()
    except Exception as error:
        if expected in str(error):
            return ", ".join(names(error)) or expected
        raise
    raise AssertionError(f"was not refused with {expected}")


def quintic(s):
    s = min(max(s, 0.0), 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


def quintic_rate(s):
    return 30.0 * (s * (1.0 - s)) ** 2 if 0.0 < s < 1.0 else 0.0


def near(values, wanted, slack, what):
    worst = max(abs(a - b) for a, b in zip(values, wanted))
    if not worst <= slack:
        raise AssertionError(f"{what}: off by {worst:.6f}, allowed {slack}")
    return worst
