#!/usr/bin/env python3
"""Follows the feed-forward torque that plumbline serves, over shared memory.

One line per new value: its number, its age, the served model, the torque of each joint. A value that is too old
is marked STALE, one without a model behind it NO MODEL or WITHDRAWN, and their torque must not be used. HAND-OVER:
the torque is on its way to the model's, within the torque-rate limit. Ctrl-C ends it.
"""

import argparse
import contextlib
import ctypes
import os
import stat
import sys
import time

import iceoryx2 as iox2

MAX_JOINTS = 8
PHASES = ("hold", "approach", "excite", "return", "stop", "stopped")
# None: no model has served yet. Withdrawn: none serves any more, and the torque is on its way to zero, or there.
VALIDITIES = ("NO MODEL", "", "HAND-OVER", "WITHDRAWN", "DOUBTFUL")


class FeedForwardMessage(ctypes.Structure):
    """The layout of plumbline's FeedForwardMessage (crates/ipc/src/messages.rs), 352 bytes."""

    _fields_ = [
        ("sequence", ctypes.c_uint64),  # number of the value since the daemon's start, from 1
        ("stamp_ns", ctypes.c_uint64),  # CLOCK_BOOTTIME when the arm's state had been read [ns]
        ("epoch", ctypes.c_uint64),  # identity of the daemon's start
        ("model", ctypes.c_uint64),  # identity of the served model, 0: none
        ("n", ctypes.c_uint32),  # number of joints
        ("phase", ctypes.c_uint32),  # what the loop is doing, see PHASES
        ("q_d", ctypes.c_double * MAX_JOINTS),  # desired position [rad]
        ("dq_d", ctypes.c_double * MAX_JOINTS),  # desired velocity [rad/s]
        ("tau_ff", ctypes.c_double * MAX_JOINTS),  # feed-forward torque [Nm]
        ("gravity", ctypes.c_double * 3),  # gravitational acceleration in the base frame [m/s2]
        ("tau_vendor", ctypes.c_double * MAX_JOINTS),  # what the arm's own controller adds: it is sent tau_ff - tau_vendor [Nm]
        ("gravity_vendor", ctypes.c_double * 3),  # gravitational acceleration that the arm's own controller compensates [m/s2]
        ("validity", ctypes.c_uint32),  # what stands behind the torque, see VALIDITIES
        ("clock", ctypes.c_uint32),  # identity of the clock of stamp_ns, see own_clock; 0: unknown
    ]

    @staticmethod
    def type_name() -> str:
        """The name under which both sides know this type."""
        return "plumbline::FeedForwardMessage"


assert ctypes.sizeof(FeedForwardMessage) == 352


def own_clock() -> int:
    """Identity of this process's CLOCK_BOOTTIME, as in plumbline's crates/ipc/src/clock.rs: FNV-1a of boot and time namespace, 0 if unknown."""
    try:
        with open("/proc/sys/kernel/random/boot_id", "rb") as boot:
            text = boot.read().rstrip() + os.readlink("/proc/self/ns/time").encode()
    except OSError:
        return 0
    identity = 0x811C9DC5
    for byte in text:
        identity = (identity ^ byte) * 0x01000193 & 0xFFFFFFFF
    return max(identity, 1)


def place() -> str:
    """The folder that this user's daemon and clients share, chosen as in plumbline's crates/ipc/src/runtime_dir.rs."""
    uid = os.geteuid()

    def ours(path: str) -> bool:
        try:
            found = os.lstat(path)
        except OSError:
            return False
        return stat.S_ISDIR(found.st_mode) and found.st_uid == uid

    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    if path := os.environ.get("PLUMBLINE_RUNTIME_DIR"):
        pass
    elif ours("/run/plumbline"):
        path = "/run/plumbline"
    elif runtime and ours(runtime):
        path = os.path.join(runtime, "plumbline")
    else:
        path = os.path.join(os.environ.get("TMPDIR", "/tmp"), f"plumbline-{uid}")
    with contextlib.suppress(FileExistsError):
        os.mkdir(path, 0o700)
    if not ours(path) or os.lstat(path).st_mode & 0o022:
        sys.exit(f"{path}: expected a directory of user {uid} that nobody else can write to")
    return path


def settings():
    """iceoryx2 as plumbline configures it: in the user's own folder, under names of the user's own."""
    config = iox2.config.default()
    config.global_cfg.root_path = iox2.Path.new(os.path.join(place(), "iceoryx2"))
    config.global_cfg.prefix = iox2.FileName.new(f"plumbline_{os.geteuid()}_")
    return config


def connect(robot: str, patience: float):
    """Subscribes to the feed-forward of `robot`, waiting up to `patience` seconds for its daemon."""
    iox2.set_log_level(iox2.LogLevel.Error)
    node = iox2.NodeBuilder.new().config(settings()).signal_handling_mode(iox2.SignalHandlingMode.Disabled)
    node = node.create(iox2.ServiceType.Ipc)
    name = iox2.ServiceName.new(f"plumbline/{robot}/feed-forward")
    end = time.monotonic() + patience
    while True:
        try:
            service = node.service_builder(name).publish_subscribe(FeedForwardMessage).open()
            return node, service, service.subscriber_builder().buffer_size(1).create()
        except iox2.PublishSubscribeOpenError as error:
            if time.monotonic() >= end:
                sys.exit(f"no daemon serves robot `{robot}` ({error})")
            time.sleep(0.02)


def newest(subscriber):
    """The newest value that has arrived since the last call, or None. Copied, as its memory is lent."""
    message = None
    while (sample := subscriber.receive()) is not None:
        message = FeedForwardMessage.from_buffer_copy(sample.payload().contents)
        # Given back before the next one is borrowed: a subscriber may hold only so many.
        del sample
    return message


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default="panda", help="identity of the robot (default: %(default)s)")
    parser.add_argument("--count", type=int, default=0, help="end after this many values (default: never)")
    parser.add_argument("--stale-ms", type=float, default=5.0, help="older values are stale [ms] (default: %(default)s)")
    parser.add_argument("--slow", type=float, default=0.0, metavar="S", help="sleep S seconds after each value")
    parser.add_argument("--wait", type=float, default=5.0, metavar="S", help="wait S seconds for the daemon (default: %(default)s)")
    options = parser.parse_args()

    _node, _service, subscriber = connect(options.robot, options.wait)
    printed, last, warned, clock = 0, None, False, own_clock()
    while options.count == 0 or printed < options.count:
        message = newest(subscriber)
        if message is None:
            # Silence is news, too: say once that the last value has gone stale.
            if last is not None and not warned:
                age_ms = (time.clock_gettime_ns(time.CLOCK_BOOTTIME) - last.stamp_ns) / 1e6
                if age_ms > options.stale_ms:
                    print(f"seq {last.sequence} STALE: nothing newer for {age_ms:.1f} ms", flush=True)
                    warned = True
            time.sleep(0.0002)
            continue
        if message.n > MAX_JOINTS or message.phase >= len(PHASES) or message.validity >= len(VALIDITIES):
            sys.exit("this is not what a plumbline daemon sends")
        if 0 not in (message.clock, clock) and message.clock != clock:
            sys.exit("the daemon's stamps are of another machine's clock: the package `plumbline` estimates ages by it")
        if last is not None and message.epoch != last.epoch:
            print("the daemon was started anew", flush=True)
        age_ms = (time.clock_gettime_ns(time.CLOCK_BOOTTIME) - message.stamp_ns) / 1e6
        mark = "STALE" if age_ms > options.stale_ms else VALIDITIES[message.validity]
        mark = f"  {mark}" if mark else ""
        tau = " ".join(f"{value:9.4f}" for value in message.tau_ff[: message.n])
        print(
            f"seq {message.sequence}  age {age_ms:.3f} ms  model {message.model:016x}  {PHASES[message.phase]}  tau {tau}{mark}",
            flush=True,
        )
        last, warned = message, False
        printed += 1
        if options.slow:
            time.sleep(options.slow)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
