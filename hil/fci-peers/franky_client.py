"""franky-control: motions planned by Ruckig on top of libfranka, 0.15 (version 9) or 0.21 (version 10)."""

import time

import franky
from peer import ADDRESS, LOST, OTHER, READY, cell, do, near, refused

robot = None


def connect():
    global robot
    robot = franky.Robot(ADDRESS, realtime_config=franky.RealtimeConfig.Ignore)
    robot.relative_dynamics_factor = 0.1
    return "yes"


def recover():
    time.sleep(0.2)
    robot.recover_from_errors()


def q():
    return list(robot.state.q)


def read():
    near(q(), READY, 0.01, "q at rest")
    return "yes"


def position():
    goal = [value + 0.1 for value in q()]
    robot.move(franky.JointMotion(goal))
    near(q(), goal, 0.005, "q at the end")
    return "yes"


def velocity():
    start = q()
    robot.move(franky.JointVelocityMotion([-0.1] * 7, franky.Duration(400)))
    robot.move(franky.JointVelocityMotion([0.0] * 7, franky.Duration(20)))
    moved = [a - b for a, b in zip(q(), start)]
    assert all(-0.3 < value < -0.03 for value in moved), moved
    return "yes"


def torque():
    # The older one ends by its duration, the newer one when it is told.
    if hasattr(franky, "TorqueStopMotion"):
        start = q()
        goal = [value + 0.03 for value in start[:4]] + start[4:]
        robot.move(franky.JointImpedanceMotion(goal), asynchronous=True)
        time.sleep(1.5)
        near(q()[:4], goal[:4], 0.03, "q under the impedance")
        robot.move(franky.TorqueStopMotion())
        return "joint impedance, stopped by its own motion"
    motion = franky.CartesianImpedanceMotion(
        franky.Affine([0.02, 0.0, 0.0]),
        franky.Duration(1000),
        target_type=franky.ReferenceType.Relative,
        translational_stiffness=400,
        rotational_stiffness=20,
    )
    robot.move(motion)
    return "Cartesian impedance through the model library"


def setters():
    robot.set_collision_behavior([20.0] * 7, [40.0] * 7, [20.0] * 6, [40.0] * 6)
    robot.set_joint_impedance([3000.0] * 4 + [2500.0, 2000.0, 2000.0])
    robot.set_cartesian_impedance([2000.0] * 3 + [100.0] * 3)
    robot.set_guiding_mode([True] * 6, False)
    identity = [1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0]
    robot.set_k(identity)
    robot.set_ee(identity)
    robot.set_load(0.0, [0.0] * 3, [0.0] * 9)
    refused(lambda: robot.set_load(-1.0, [0.0] * 3, [0.0] * 9), "invalid argument")
    return "all; a bad load refused"


def model():
    assert "<robot" in robot.model_urdf
    gravity = list(robot.model.gravity(robot.state))
    near(gravity, robot.state.tau_J, 1.5, "gravity from the description against the measured torque")
    return "description read, its gravity is the measured torque"


def slowly(order):
    robot.move(franky.JointMotion([value + 0.2 for value in q()], relative_dynamics_factor=0.3), asynchronous=True)
    time.sleep(0.2)
    do(order)
    robot.join_motion()


def lost():
    text = refused(lambda: slowly("fault loss=1,of=commands,for=0.1"), LOST)
    refused(lambda: robot.move(franky.JointMotion(q())), "not possible")
    recover()
    robot.move(franky.JointMotion(READY))
    return text


def pressed():
    text = refused(lambda: slowly("user-stop"), "User Stop")
    do("release")
    return text


def stop():
    robot.move(franky.JointMotion([value + 0.2 for value in q()], relative_dynamics_factor=0.3), asynchronous=True)
    time.sleep(0.3)
    robot.stop()
    try:
        robot.join_motion()
    except franky.ControlException as error:
        assert "preempted" in str(error), error
    return "preempted"


def version():
    return refused(
        lambda: franky.Robot(OTHER, realtime_config=franky.RealtimeConfig.Ignore), "Incompatible"
    ) and "both versions named"


if cell("connect", connect):
    cell("read", read)
    cell("joint positions", position, recover)
    cell("joint velocities", velocity, recover)
    cell("torques", torque, recover)
    cell("setters", setters, recover)
    cell("model", model, recover)
    cell("commands lost", lost, recover)
    cell("recovery", lambda: (lost(), "after a refusal of the next motion")[1], recover)
    cell("user stop while moving", pressed, recover)
    cell("stop", stop, recover)
    if OTHER:
        cell("another version", version)
