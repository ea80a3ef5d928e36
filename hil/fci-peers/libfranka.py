"""The same exercises for both Python bindings of libfranka: they differ in how a command is sent, not in what there is to do."""

import time

from peer import LOST, OTHER, READY, STALL, cell, do, near, quintic, quintic_rate, refused

# How far each joint goes, and how long that takes.
FAR, LONG = 0.1, 1.2


class Exercises:
    """A binding has `connect(address)`, and `positions(robot, step)`, `velocities(robot, step)`, `torques(robot, step)`, whose
    `step(state, t)` returns the command and whether it is the last one."""

    def __init__(self, binding):
        self.binding = binding
        self.robot = None

    def state(self):
        # A socket that nobody read was full of old states, and the newest of them is the first that comes.
        self.robot.read_once()
        return self.robot.read_once()

    def recover(self):
        time.sleep(0.2)
        self.robot.automatic_error_recovery()

    def connect(self):
        self.robot = self.binding.connect()
        return f"server version {self.robot.server_version()}" if hasattr(self.robot, "server_version") else "yes"

    def read(self):
        states = [self.state() for _ in range(5)]
        times = [self.binding.milliseconds(state) for state in states]
        assert all(a < b for a, b in zip(times, times[1:])), times
        near(states[-1].q, READY, 0.01, "q at rest")
        near(states[-1].O_T_EE[12:15], [0.307, 0.0, 0.590], 0.01, "the flange")
        return "yes"

    def position(self):
        start = list(self.state().q_d)

        def step(state, t):
            share = quintic(t / LONG)
            return [q + FAR * share for q in start], t > LONG

        self.binding.positions(self.robot, step)
        end = self.state()
        near(end.q, [q + FAR for q in start], 0.005, "q at the end")
        self.measured_start()
        return "yes"

    def measured_start(self):
        # As libfranka's examples since 0.21: from the measured position, which is not quite the desired one.
        start = []

        def step(state, t):
            if not start:
                start.extend(state.q)
            return [q + 0.02 * quintic(t / 0.5) for q in start], t > 0.5

        self.binding.positions(self.robot, step)
        near(self.state().q, [q + 0.02 for q in start], 0.005, "q at the end of a motion from the measured position")

    def velocity(self):
        start = list(self.state().q_d)

        def step(state, t):
            return [-FAR / LONG * quintic_rate(t / LONG)] * 7, t > LONG

        self.binding.velocities(self.robot, step)
        # Where commands were lost, the integral is not the trajectory's.
        near(self.state().q, [q - FAR for q in start], 0.02, "q at the end")
        return "yes"

    def torque(self):
        start = list(self.state().q)
        stiffness = [400.0, 400.0, 400.0, 400.0, 80.0, 80.0, 30.0]
        damping = [40.0, 40.0, 40.0, 40.0, 8.0, 8.0, 3.0]
        last = [0.0] * 7

        def step(state, t):
            goal = 0.05 * quintic(t / LONG)
            for j in range(7):
                wanted = stiffness[j] * (start[j] + goal - state.q[j]) - damping[j] * state.dq[j]
                last[j] += max(-0.8, min(0.8, wanted - last[j]))
            return list(last), t > LONG + 0.3

        self.binding.torques(self.robot, step)
        near(self.state().q[:4], [q + 0.05 for q in start[:4]], 0.02, "q at the end")
        return "yes"

    def setters(self):
        robot, taken = self.robot, []
        identity = [1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0]
        raised = list(identity)
        raised[14] = 0.1
        for name, call in self.binding.setters(robot, raised):
            call()
            taken.append(name)
        robot.set_load(0.3, [0.0, 0.0, 0.05], [0.001, 0, 0, 0, 0.001, 0, 0, 0, 0.001])
        state = self.state()
        assert abs(state.m_load - 0.3) < 1e-6 and abs(state.F_x_Cload[2] - 0.05) < 1e-6, (state.m_load, state.F_x_Cload)
        near(state.EE_T_K, raised, 1e-6, "EE_T_K")
        near(state.F_T_EE, raised, 1e-6, "F_T_EE")
        robot.set_load(0.0, [0.0] * 3, [0.0] * 9)
        for _, call in self.binding.setters(robot, identity):
            call()
        refused(lambda: robot.set_load(-1.0, [0.0] * 3, [0.0] * 9), "invalid argument")
        refused(lambda: robot.set_load(20.0, [5.0, 0.0, 0.0], [0.0] * 9), "invalid argument")
        refused(lambda: robot.set_joint_impedance([-1.0] * 7), "invalid argument")
        refused(lambda: robot.set_joint_impedance([0.0] * 7), "invalid argument")
        return ", ".join(taken + ["load"]) + "; bad ones refused"

    def jump(self):
        start = list(self.state().q_d)

        def step(state, t):
            return ([q + 0.01 for q in start] if t > 0.02 else start), False

        return refused(lambda: self.binding.positions(self.robot, step), "joint_motion_generator_velocity_discontinuity")

    def wrong_start(self):
        start = list(self.state().q_d)
        return refused(
            lambda: self.binding.positions(self.robot, lambda state, t: ([q + 0.3 for q in start], False)),
            "joint_position_motion_generator_start_pose_invalid",
        )

    def too_fast(self):
        start = list(self.state().q_d)
        most, ramp = 8.0, 0.05

        # `most` rad/s2 for good, after a start within the jerk.
        def step(state, t):
            if t < ramp:
                q = most * t**3 / (6.0 * ramp)
            else:
                after = t - ramp
                q = most * (ramp**2 / 6.0 + 0.5 * ramp * after + 0.5 * after**2)
            return start[:6] + [start[6] - q], False

        return refused(
            lambda: self.binding.positions(self.robot, step), "joint_motion_generator_velocity_limits_violation"
        )

    def out_of_range(self):
        # Up to image 5.7.1 the generator's own error, the joint's from then on.
        old = self.binding.version < 9
        name = "joint_motion_generator_position_limits_violation" if old else "joint_position_limits_violation"
        start = list(self.state().q_d)
        return refused(
            lambda: self.binding.positions(
                self.robot, lambda state, t: (start[:6] + [3.1] if t > 0.02 else start, False)
            ),
            name,
        )

    def collision(self):
        # Less than the noise of the sensors: any motion is a collision.
        self.robot.set_collision_behavior([0.001] * 7, [0.001] * 7, [100.0] * 6, [100.0] * 6)
        try:
            return refused(self.position_unrecovered, "joint_reflex")
        finally:
            self.recover()
            self.robot.set_collision_behavior([20.0] * 7, [30.0] * 7, [20.0] * 6, [30.0] * 6)

    def torque_range(self):
        def step(state, t):
            return ([0.0] * 6 + [13.0] if t > 0.02 else [0.0] * 7), False

        return refused(lambda: self.binding.torques(self.robot, step), "tau_J_range_violation")

    def torque_step(self):
        def step(state, t):
            return ([0.0] * 6 + [5.0] if t > 0.02 else [0.0] * 7), False

        return refused(lambda: self.binding.torques(self.robot, step), "controller_torque_discontinuity")

    def stall(self):
        start = list(self.state().q_d)
        stalled = []

        def step(state, t):
            if t > 0.05 and not stalled:
                stalled.append(True)
                time.sleep(STALL)
            return start, t > 0.5

        return refused(lambda: self.binding.positions(self.robot, step), LOST)

    def recovery(self):
        # A reflex that nobody has recovered from lets no motion begin; afterwards motions run as before.
        self.jump()
        refused(self.position_unrecovered, "command not possible")
        self.recover()
        self.position_unrecovered()
        return "after a refusal of the next motion"

    def position_unrecovered(self):
        start = list(self.state().q_d)
        self.binding.positions(self.robot, lambda state, t: (start, t > 0.05))

    def user_stop(self):
        do("user-stop")
        shown = str(self.state().robot_mode)
        assert "UserStopped" in shown, shown
        refused(self.position_unrecovered, "not possible")
        do("release")
        self.position_unrecovered()
        return "mode, refusal and release"

    def pressed(self):
        start = list(self.state().q_d)
        pressed = []

        def step(state, t):
            if t > 0.05 and not pressed:
                pressed.append(True)
                print("DO user-stop", flush=True)
            return start, t > 3.0

        text = refused(lambda: self.binding.positions(self.robot, step), "User Stop")
        do("release")
        return text

    def network(self):
        start = list(self.state().q_d)
        asked = []

        def step(state, t):
            if t > 0.05 and not asked:
                asked.append(True)
                print("DO fault loss=1,of=commands,for=0.1", flush=True)
            return start, t > 3.0

        return refused(lambda: self.binding.positions(self.robot, step), LOST)

    def version(self):
        return refused(lambda: self.binding.connect(OTHER), "ersion") and "both versions named"

    def run(self):
        if not cell("connect", self.connect):
            return
        cell("read", self.read)
        cell("joint positions", self.position, self.recover)
        cell("joint velocities", self.velocity, self.recover)
        cell("torques", self.torque, self.recover)
        cell("setters", self.setters, self.recover)
        cell("model", lambda: self.binding.model(self.robot), self.recover)
        for name, action in [
            ("jump", self.jump),
            ("wrong start", self.wrong_start),
            ("too fast", self.too_fast),
            ("out of range", self.out_of_range),
            ("torque step", self.torque_step),
            ("torque range", self.torque_range),
            ("collision", self.collision),
            ("stall", self.stall),
            ("commands lost", self.network),
        ]:
            cell(name, action, self.recover)
            self.recover()
        cell("recovery", self.recovery, self.recover)
        cell("user stop while idle", self.user_stop, self.recover)
        cell("user stop while moving", self.pressed, self.recover)
        if OTHER:
            cell("another version", self.version)
