"""panda-python: libfranka 0.9 in Python, protocol version 5."""

import panda_py.libfranka as lib
from libfranka import Exercises
from peer import ADDRESS, cell, near


class Binding:
    """Motions are callbacks that libfranka calls."""

    version = 5

    def connect(self, address=ADDRESS):
        return lib.Robot(address, lib.RealtimeConfig.kIgnore)

    def milliseconds(self, state):
        return state.time.to_msec()

    def loop(self, control, step, make):
        clock = [0.0]

        def callback(state, period):
            clock[0] += period.to_sec()
            values, last = step(state, clock[0])
            command = make(values)
            if last:
                command.motion_finished = True
            return command

        # Neither rate limiter nor low-pass: what arrives is what was commanded.
        control(callback, limit_rate=False, cutoff_frequency=1000.0)

    def positions(self, robot, step):
        self.loop(robot.control_joint_position, step, lib.JointPositions)

    def velocities(self, robot, step):
        self.loop(robot.control_joint_velocity, step, lib.JointVelocities)

    def torques(self, robot, step):
        self.loop(robot.control, step, lib.Torques)

    def setters(self, robot, pose):
        return [
            ("collision", lambda: robot.set_collision_behavior([20.0] * 7, [30.0] * 7, [20.0] * 6, [30.0] * 6)),
            ("joint impedance", lambda: robot.set_joint_impedance([3000.0] * 4 + [2500.0, 2000.0, 2000.0])),
            ("Cartesian impedance", lambda: robot.set_cartesian_impedance([2000.0] * 3 + [100.0] * 3)),
            ("guiding", lambda: robot.set_guiding_mode([True] * 6, False)),
            ("EE", lambda: robot.set_ee(pose)),
            ("K", lambda: robot.set_k(pose)),
        ]

    def model(self, robot):
        model = robot.load_model()
        state = robot.read_once()
        near(model.pose(lib.Frame.kFlange, state)[12:15], state.O_T_EE[12:15], 0.002, "the library's flange")
        return "library loaded"


def whole():
    """The package's own arm on top of libfranka: it plans, and drives by torques."""
    import panda_py

    panda = panda_py.Panda(ADDRESS)
    goal = [q + 0.05 for q in panda.q]
    assert panda.move_to_joint_position(goal)
    near(panda.q, goal, 0.02, "q at the end")
    return "its own planner and torque controller arrive"


exercises = Exercises(Binding())
exercises.run()
# Its connection ends with it: the next one is another client.
exercises.robot = None
cell("its own motions", whole)
