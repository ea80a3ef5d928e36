"""pylibfranka: libfranka 0.21 in Python, protocol version 10."""

import pylibfranka as lib
from libfranka import Exercises
from peer import ADDRESS, near


class Binding:
    """Motions are a loop of readOnce and writeOnce."""

    version = 10

    def connect(self, address=ADDRESS):
        return lib.Robot(address, lib.RealtimeConfig.kIgnore)

    def milliseconds(self, state):
        return round(state.time.to_sec() * 1e3)

    def loop(self, control, step, make):
        t = None
        while True:
            state, period = control.readOnce()
            # The first period reaches back to before the motion.
            t = 0.0 if t is None else t + period.to_sec()
            values, last = step(state, t)
            command = make(values)
            command.motion_finished = last
            control.writeOnce(command)
            if last:
                return

    def positions(self, robot, step):
        control = robot.start_joint_position_control(lib.ControllerMode.JointImpedance)
        self.loop(control, step, lib.JointPositions)

    def velocities(self, robot, step):
        control = robot.start_joint_velocity_control(lib.ControllerMode.JointImpedance)
        self.loop(control, step, lib.JointVelocities)

    def torques(self, robot, step):
        self.loop(robot.start_torque_control(), step, lib.Torques)

    def setters(self, robot, pose):
        return [
            ("collision", lambda: robot.set_collision_behavior([20.0] * 7, [30.0] * 7, [20.0] * 6, [30.0] * 6)),
            ("joint impedance", lambda: robot.set_joint_impedance([3000.0] * 4 + [2500.0, 2000.0, 2000.0])),
            ("Cartesian impedance", lambda: robot.set_cartesian_impedance([2000.0] * 3 + [100.0] * 3)),
            ("EE", lambda: robot.set_EE(pose)),
            ("K", lambda: robot.set_K(pose)),
        ]

    def model(self, robot):
        model = robot.load_model()
        state = robot.read_once()
        # Pinocchio on the served description against the torques that the arm's sensors show at rest, up to their friction.
        gravity = model.gravity(state)
        near(gravity, state.tau_J, 1.5, "gravity from the description against the measured torque")
        # Once more while a motion runs, as joint_impedance_example.py does.
        start, asked = list(state.q_d), []

        def step(state, t):
            if t > 0.05 and not asked:
                asked.append(robot.load_model())
            return start, t > 0.2

        self.positions(robot, step)
        return "description read, its gravity is the measured torque"


Exercises(Binding()).run()
