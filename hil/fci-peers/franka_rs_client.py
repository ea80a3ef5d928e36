"""franka-rs: a client in Rust without libfranka, protocol versions 5 and 10, through its Python package."""

import time

import franka
from peer import ADDRESS, LOST, READY, cell, do, near, refused

robot = None


def connect():
    global robot
    robot = franka.Robot(ADDRESS, realtime="ignore")
    return f"version {robot.fci_version}"


def recover():
    time.sleep(0.2)
    robot.automatic_error_recovery()


def read():
    state = robot.read_once()
    near(state.q, READY, 0.01, "q at rest")
    return "yes"


def go(backend):
    start = list(robot.read_once().q)
    goal = [value + 0.05 for value in start]
    with robot.joint_targets(fraction=0.1, backend=backend) as arm:
        arm.move_to(goal)
        time.sleep(2.0)
        reached = list(arm.state().q)
    near(reached[:4], goal[:4], 0.02, "q at the target")
    return "yes"


def setters():
    robot.set_collision_behavior_simple([40.0] * 7, [60.0] * 7, [40.0] * 6, [60.0] * 6)
    robot.set_joint_impedance([3000.0] * 4 + [2500.0, 2000.0, 2000.0])
    robot.set_cartesian_impedance([2000.0] * 3 + [100.0] * 3)
    refused(lambda: robot.set_joint_impedance([-1.0] * 7), "nvalid")
    return "collision, joint and Cartesian impedance; a bad one refused"


def model():
    model, state = robot.model(), robot.read_once()
    near(model.pose("flange", state.q)[:3, 3], state.O_T_EE[12:15] if len(state.O_T_EE) == 16 else state.O_T_EE[:3, 3], 0.002, "the flange")
    if robot.fci_version < 10:
        return "its own, built in: same flange"
    gravity = list(model.gravity(state.q))
    near(gravity, state.tau_J, 1.5, "gravity from the description against the measured torque")
    return "description read, its gravity is the measured torque"


def during(order):
    with robot.joint_targets(fraction=0.1, backend="robot") as arm:
        time.sleep(0.3)
        do(order)
        time.sleep(0.5)
        arm.stop()


def lost():
    return refused(lambda: during("fault loss=1,of=commands,for=0.1"), LOST)


def recovery():
    lost()
    refused(lambda: go("robot"), "ossible")
    recover()
    go("robot")
    return "after a refusal of the next motion"


def pressed():
    try:
        during("user-stop")
    except franka.FrankaError as error:
        do("release")
        return " ".join(str(error).split())[:120]
    raise AssertionError("the user stop did not end the motion")


if cell("connect", connect):
    cell("read", read)
    cell("setters", setters, recover)
    cell("joint positions", lambda: go("robot"), recover)
    cell("torques", lambda: go("impedance"), recover)
    cell("model", model, recover)
    cell("commands lost", lost, recover)
    recover()
    cell("recovery", recovery, recover)
    cell("user stop while moving", pressed, recover)
