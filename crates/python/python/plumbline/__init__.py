"""plumbline: the identified dynamics of a robot arm, offline and in a controller.

    import plumbline

    results = plumbline.identify("dataset", out="out")           # as `plumbline identify`
    results.report["identify"]["rms_raw"]

    model = plumbline.Model.load("out/model.toml", plumbline.gravity("wall"))
    tau = model.torque(q, dq, ddq)                                # arrays of n values, or one state per row

    model = plumbline.Model.follow("panda")                       # the model that the daemon serves
    guest = plumbline.Guest("panda", 7)                           # states for the daemon
    guest.publish(q, dq, tau, q_d)

    torque = plumbline.FeedForward("panda").latest()              # torque of the daemon's own motion

Every error is an exception of `plumbline.errors`, a subclass of `plumbline.Error`.
"""

from . import errors
from ._plumbline import FeedForward, Guest, Model, Motion, Status, Torque, __version__, gravity
from .errors import Error, InputError, JobError
from .offline import Contact, External, Prediction, Results, compare, diagnose, identify, plan, predict

__all__ = [
    "Contact",
    "Error",
    "External",
    "FeedForward",
    "Guest",
    "InputError",
    "JobError",
    "Model",
    "Motion",
    "Prediction",
    "Results",
    "Status",
    "Torque",
    "__version__",
    "compare",
    "diagnose",
    "errors",
    "gravity",
    "identify",
    "plan",
    "predict",
]
