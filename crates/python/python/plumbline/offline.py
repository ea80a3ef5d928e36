"""Work on files without a daemon. Options are those of the command line: `plumbline identify --help` describes them.

None leaves an option at its default. A computation releases the interpreter's lock; Ctrl-C takes effect when it has ended, in `plan` at once.
"""

from __future__ import annotations

import html
import json
import os
import tempfile
from pathlib import Path
from typing import Any, NamedTuple, Optional, Sequence, Union

import numpy as np

from . import _plumbline
from ._plumbline import Model, Motion

PathLike = Union[str, "os.PathLike[str]"]


def _arguments(positional: Sequence[PathLike], options: dict[str, Any]) -> list[str]:
    """Arguments as on the command line."""
    arguments = []
    for name, value in options.items():
        option = "--" + name.replace("_", "-")
        if value is True:
            arguments.append(option)
        elif value is not None and value is not False:
            several = isinstance(value, (list, tuple))
            arguments.append(f"{option}={','.join(map(str, value)) if several else value}")
    return [*arguments, "--", *map(os.fspath, positional)]


class Results:
    """A folder of results: `report.json`, `report.html`, `model.toml`. Also of `plumbline run`: `Results("results/sim-panda-wall")`."""

    def __init__(self, folder: PathLike):
        self.folder = Path(folder)
        self._temporary: Optional[tempfile.TemporaryDirectory[str]] = None
        with open(self.folder / "report.json", encoding="utf-8") as file:
            #: The content of report.json.
            self.report: dict[str, Any] = json.load(file)

    @property
    def html(self) -> str:
        """The content of report.html."""
        return (self.folder / "report.html").read_text(encoding="utf-8")

    @property
    def model_toml(self) -> str:
        """The text of the model file."""
        return (self.folder / "model.toml").read_text(encoding="utf-8")

    @property
    def gravity(self) -> np.ndarray:
        """Gravitational acceleration of the report's mounting, in the base frame [m/s2]."""
        mounting = self.report["mounting"]
        return _plumbline.gravity(f"{mounting['rho']!r} rad,{mounting['phi']!r} rad")

    @property
    def model(self) -> Model:
        """A new model of model.toml, under the gravity of the report's mounting."""
        return Model.load(self.folder / "model.toml", self.gravity)

    def _repr_html_(self) -> str:
        # A page of its own: its styles must not reach the notebook.
        page = html.escape(self.html, quote=True)
        return f'<iframe srcdoc="{page}" width="100%" height="800" style="border: 0"></iframe>'

    def __repr__(self) -> str:
        verdict = (self.report.get("diagnosis") or {}).get("verdict")
        base = self.report["base"]
        found = f", {verdict}" if verdict else ""
        return f"<Results of {self.report['robot']}: {base['kind']}, {base['count']} parameters{found}, {self.folder}>"


def _results(work: Any, positional: Sequence[PathLike], out: Optional[PathLike], options: dict[str, Any]) -> Results:
    temporary = tempfile.TemporaryDirectory(prefix="plumbline-") if out is None else None
    folder = temporary.name if temporary else os.fspath(out)  # type: ignore[arg-type]
    work(_arguments(positional, {"out": folder, **options}))
    results = Results(folder)
    # A folder without a name of the caller's lives as long as its results.
    results._temporary = temporary
    return results


def identify(
    dataset: PathLike,
    *,
    out: Optional[PathLike] = None,
    terms: Optional[Sequence[str]] = None,
    estimator: Optional[str] = None,
    essential: bool = False,
    method: Optional[str] = None,
    torque_cutoff: Optional[float] = None,
    position_cutoff: Optional[float] = None,
    order: Optional[int] = None,
    velocities: Optional[str] = None,
    trim: Optional[float] = None,
    keep_rests: bool = False,
    hold_out: Optional[float] = None,
) -> Results:
    """Identifies from a dataset (folder with dataset.toml), as `plumbline identify`. Results are written to `out`, or to a temporary folder."""
    options = {
        "terms": terms,
        "estimator": estimator,
        "essential": essential,
        "method": method,
        "torque_cutoff": torque_cutoff,
        "position_cutoff": position_cutoff,
        "order": order,
        "velocities": velocities,
        "trim": trim,
        "keep_rests": keep_rests,
        "hold_out": hold_out,
    }
    return _results(_plumbline.identify, [dataset], out, options)


def diagnose(
    dataset: PathLike,
    *,
    out: Optional[PathLike] = None,
    terms: Optional[Sequence[str]] = None,
    estimator: Optional[str] = None,
    essential: bool = False,
    method: Optional[str] = None,
    torque_cutoff: Optional[float] = None,
    position_cutoff: Optional[float] = None,
    order: Optional[int] = None,
    velocities: Optional[str] = None,
    trim: Optional[float] = None,
    keep_rests: bool = False,
    hold_out: Optional[float] = None,
    band: Optional[float] = None,
    threshold: Optional[float] = None,
    until: Optional[float] = None,
) -> Results:
    """Finds effects that a plain model lacks, as `plumbline diagnose`. Results are written to `out`, or to a temporary folder."""
    options = {
        "terms": terms,
        "estimator": estimator,
        "essential": essential,
        "method": method,
        "torque_cutoff": torque_cutoff,
        "position_cutoff": position_cutoff,
        "order": order,
        "velocities": velocities,
        "trim": trim,
        "keep_rests": keep_rests,
        "hold_out": hold_out,
        "band": band,
        "threshold": threshold,
        "until": until,
    }
    return _results(_plumbline.diagnose, [dataset], out, options)


def compare(
    model: PathLike,
    dataset: PathLike,
    *,
    out: Optional[PathLike] = None,
    velocities: Optional[str] = None,
    trim: Optional[float] = None,
    threshold: Optional[float] = None,
) -> Results:
    """Shows what changed since a model file was identified, as `plumbline compare`. Results are written to `out`, or to a temporary folder."""
    options = {"velocities": velocities, "trim": trim, "threshold": threshold}
    return _results(_plumbline.compare, [model, dataset], out, options)


class Contact(NamedTuple):
    """A time in which contact is flagged."""

    #: Begin and end on the clock of the recording [s].
    begin: float
    end: float
    #: Largest external torque in it, per joint [Nm].
    torque: np.ndarray
    #: Joints that exceed their thresholds, from 1.
    joints: list[int]


class External(NamedTuple):
    """External torque along a motion as a controller would have it, one row per sample."""

    #: Measured less modelled torque behind the low-pass [Nm].
    tau: np.ndarray
    #: 95 % interval [Nm].
    low: np.ndarray
    high: np.ndarray
    #: Whether a joint exceeds its threshold.
    contact: np.ndarray
    contacts: list[Contact]
    #: Largest threshold along the motion, per joint [Nm].
    thresholds: np.ndarray
    #: The same as a wrench at the end effector in the base frame, force [N] and moment [Nm]; None where every pose is nearly singular.
    wrench_thresholds: Optional[np.ndarray]
    #: Delay of the low-pass [s].
    delay: float


class Prediction(NamedTuple):
    """Torques of a model along a motion, one row per sample."""

    #: Time [s].
    t: np.ndarray
    #: Predicted torque [Nm].
    tau: np.ndarray
    #: Whether the sample is near an end of the motion, where the acceleration depends on the filter.
    at_end: np.ndarray
    #: 95 % prediction interval of one measured sample [Nm]; None without an uncertainty in the model file.
    low: Optional[np.ndarray]
    high: Optional[np.ndarray]
    #: RMS of measured minus predicted torque per joint [Nm]; None without measured torques.
    rms_raw: Optional[np.ndarray]
    rms_filtered: Optional[np.ndarray]
    #: Share of measured torques within the interval, per joint.
    coverage: Optional[np.ndarray]
    #: What is unusual in the recorded motion.
    warnings: list[str]
    #: External torque; None unless it was asked for.
    external: Optional[External]


def predict(
    model: PathLike,
    run: PathLike,
    *,
    mounting: Optional[str] = None,
    force: bool = False,
    consistent: bool = False,
    velocities: Optional[str] = None,
    external: bool = False,
    bandwidth: Optional[float] = None,
    false_alarms: Optional[float] = None,
    by: Optional[str] = None,
) -> Prediction:
    """Computes the torques of a model file along a recorded motion (CSV), as `plumbline predict`; with `external`, the external torque, too."""
    options = {
        "mounting": mounting,
        "force": force,
        "consistent": consistent,
        "velocities": velocities,
        "external": external,
        "bandwidth": bandwidth,
        "false_alarms": false_alarms,
        "by": by,
    }
    found = _plumbline.predict(_arguments([model, run], options))
    seen = None
    if external:
        tau, low, high = (found.pop(name) for name in ("tau_ext", "tau_ext_low", "tau_ext_high"))
        contacts = [Contact(*one) for one in found.pop("contacts")]
        rest = {name: found.pop(name) for name in ("contact", "thresholds", "wrench_thresholds", "delay")}
        seen = External(tau, low, high, contacts=contacts, **rest)
    return Prediction(**found, external=seen)


def plan(
    robot: PathLike,
    *,
    mounting: Optional[str] = None,
    criterion: Optional[str] = None,
    model: Optional[PathLike] = None,
    trajectories: Optional[int] = None,
    validate: Optional[int] = None,
    period: Optional[float] = None,
    harmonics: Optional[int] = None,
    starts: Optional[int] = None,
    rounds: Optional[int] = None,
    seconds: Optional[float] = None,
    seed: Optional[int] = None,
    links_in_box: bool = False,
) -> list[Motion]:
    """Searches excitations, as `plumbline plan`: motions to identify from, then those to validate with."""
    options = {
        "robot": robot,
        "mounting": mounting,
        "criterion": criterion,
        "model": model,
        "trajectories": trajectories,
        "validate": validate,
        "period": period,
        "harmonics": harmonics,
        "starts": starts,
        "rounds": rounds,
        "seconds": seconds,
        "seed": seed,
        "links_in_box": links_in_box,
    }
    return _plumbline.plan(_arguments([], options))
