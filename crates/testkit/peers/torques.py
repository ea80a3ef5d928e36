"""Torques of Pinocchio and MuJoCo for exported models: reads one JSON object on standard input, writes one on standard output.

    {"urdf": [{"text", "cases": [..]}], "mjcf": [{"text", "cases": [..]}]}  ->  {"urdf": [[[tau per joint] per case]], "mjcf": ..}

A case has gravity (in the base frame), q, dq, ddq. MuJoCo's constraints (limits, dry friction) are off: they are no part of the
equation of motion; damping and armature are.
"""

import json
import sys

import numpy as np


def urdf(robot):
    import pinocchio as pin

    model = pin.buildModelFromXML(robot["text"])
    out = []
    for case in robot["cases"]:
        model.gravity = pin.Motion(np.array(case["gravity"]), np.zeros(3))
        tau = pin.rnea(model, model.createData(), *(np.array(case[key]) for key in ("q", "dq", "ddq")))
        out.append(tau.tolist())
    return out


def mjcf(robot):
    import mujoco

    model = mujoco.MjModel.from_xml_string(robot["text"])
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    out = []
    for case in robot["cases"]:
        data = mujoco.MjData(model)
        model.opt.gravity[:] = case["gravity"]
        data.qpos[:], data.qvel[:], data.qacc[:] = case["q"], case["dq"], case["ddq"]
        mujoco.mj_inverse(model, data)
        out.append(data.qfrc_inverse.tolist())
    return out


request = json.load(sys.stdin)
json.dump({"urdf": [urdf(r) for r in request["urdf"]], "mjcf": [mjcf(r) for r in request["mjcf"]]}, sys.stdout)
