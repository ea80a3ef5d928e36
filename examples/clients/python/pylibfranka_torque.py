#!/usr/bin/env python3
"""A compliant joint-torque loop at 1 kHz with pylibfranka, to which plumbline adds the identified torque. plumbline listens and commands nothing.

    plumbline run config/guest.toml --set mounting=upright --set backend.guest.identify="40 s" --set backend.guest.validate="10 s"
    python3 pylibfranka_torque.py --address 172.16.0.2 --seconds 120

The loop follows a motion with low gains and publishes every state. When the daemon has identified a model, the loop adds its torque.
It prints the tracking error before and after. Needs the packages plumbline-robot and pylibfranka.

On a robot: keep the user stop at hand, and the workspace free of people and things.
"""

import argparse
import sys
import threading
import time

import numpy as np
import pylibfranka

import plumbline

N = 7
STIFFNESS = np.full(N, 50.0)  # [Nm/rad]
DAMPING = np.array([8.0, 8.0, 8.0, 8.0, 4.0, 4.0, 4.0])  # [Nms/rad]
MAX_STEP = 0.8  # largest change of a torque in one cycle [Nm]; the robot's limit is 1
FADE = 2.0  # time over which motion and torque are faded in and out [s]
SLOW, QUICK = 1.1 + 0.21 * np.sqrt(np.arange(N)), 2.3 + 0.37 * np.sqrt(1.0 + np.arange(N))  # [rad/s]


def fade(t):
    """Quintic from 0 to 1 over FADE with its first two derivatives."""
    s = min(max(t / FADE, 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / FADE, 60 * s * (1 - s) * (1 - 2 * s) / FADE**2


def motion(t, end):
    """Displacement [rad], velocity and acceleration of two tones per joint, faded in and out."""
    tones = [(0.35, SLOW, np.arange(N)), (0.15, QUICK, np.zeros(N))]
    q = sum(a * (np.sin(w * t + p) - np.sin(p)) for a, w, p in tones)
    dq = sum(a * w * np.cos(w * t + p) for a, w, p in tones)
    ddq = sum(-a * w**2 * np.sin(w * t + p) for a, w, p in tones)
    f, df, ddf = fade(t) if t < end - FADE else fade(end - t)
    df = df if t < end - FADE else -df
    return f * q, df * q + f * dq, ddf * q + 2 * df * dq + f * ddq


class Served:
    """The model that the daemon serves, looked for by a thread beside the loop."""

    def __init__(self, robot, gravity):
        self.model = None
        # Gravity that the robot compensates, whatever its mounting. None where it is the one that acts.
        upright = plumbline.gravity("upright")
        self.compensated = None if np.allclose(gravity, upright) else upright
        threading.Thread(target=self.follow, args=(robot, gravity), daemon=True).start()

    def follow(self, robot, gravity):
        while self.model is None:
            try:
                model = plumbline.Model.follow(robot, expected_gravity=gravity, timeout=1.0)
            except plumbline.errors.NoDaemon:
                continue
            while model.status().model == 0:
                time.sleep(0.05)
            self.model = model

    def torque(self, q, dq, ddq):
        """What is sent: the robot adds the torque of gravity itself."""
        rest, vendor = np.zeros(N), self.model.gravity(q)
        if self.compensated is not None:
            vendor += self.model.torque(q, rest, rest, self.compensated) - self.model.torque(q, rest, rest)
        return self.model.torque(q, dq, ddq) - vendor


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--address", default="172.16.0.2", help="of the robot (default: %(default)s)")
    parser.add_argument("--robot", default="panda", help="serve.id of the daemon (default: %(default)s)")
    parser.add_argument("--mounting", default="upright", help="of the robot (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=120.0, help="length of the motion (default: %(default)s)")
    # Torque sensors on the links' side do not show the rotors, so no model identified from them has their inertia. The emulator's is 0.1.
    parser.add_argument("--rotor-inertia", type=float, default=0.0, help="of every joint, which a torque accelerates too [kg m2] (default: 0)")
    options = parser.parse_args()

    robot = pylibfranka.Robot(options.address, pylibfranka.RealtimeConfig.kIgnore)
    robot.set_collision_behavior([80.0] * N, [80.0] * N, [80.0] * 6, [80.0] * 6)
    guest = plumbline.Guest(options.robot, N)
    served = Served(options.robot, plumbline.gravity(options.mounting))
    errors = {"without": [], "with": []}
    control = robot.start_torque_control()
    t, start, last, since = None, None, np.zeros(N), None
    while True:
        state, period = control.readOnce()
        t = 0.0 if t is None else t + period.to_sec()
        q, dq = np.array(state.q), np.array(state.dq)
        start = q if start is None else start
        q_d, dq_d, ddq_d = motion(t, options.seconds)
        q_d = start + q_d
        guest.publish(q, dq, state.tau_J, q_d)

        wanted = STIFFNESS * (q_d - q) + DAMPING * (dq_d - dq)
        if served.model is not None:
            since = t if since is None else since
            wanted += fade(t - since)[0] * (served.torque(q_d, dq_d, ddq_d) + options.rotor_inertia * ddq_d)
        if FADE < t < options.seconds - FADE and (since is None or t > since + 2 * FADE):
            errors["without" if since is None else "with"].append(q_d - q)

        last = last + np.clip(wanted - last, -MAX_STEP, MAX_STEP)
        command = pylibfranka.Torques(list(last))
        command.motion_finished = t > options.seconds
        control.writeOnce(command)
        if command.motion_finished:
            break

    rms = {name: np.sqrt(np.mean(np.square(some), axis=0)) for name, some in errors.items() if some}
    for name, values in rms.items():
        print(f"tracking error {name} the model's torque [mrad]: " + " ".join(f"{1e3 * value:.2f}" for value in values))
    if len(rms) == 2:
        print("ratio: " + " ".join(f"{a / b:.1f}" for a, b in zip(rms["without"], rms["with"])))
    return 0 if len(rms) == 2 else 1


if __name__ == "__main__":
    sys.exit(main())
