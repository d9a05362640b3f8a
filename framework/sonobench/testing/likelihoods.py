"""What likelihoods of fields must do."""

from __future__ import annotations

from typing import Any

import numpy as np

from sonobench.errors import SetupError
from sonobench.testing import fixtures
from sonobench.testing.kit import Case, Skip, claim, need, unmet, untouched
from sonobench.testing.trackers import refused
from sonobench.types import Scan, Setup, Space

_LIKELIHOOD = ("likelihood",)


def _bound(case: Case) -> tuple[Any, Space, Setup]:
    """The likelihood bound to the first space and setup that it takes."""
    errors: list[str] = []
    for grouping in ("pairs", "stack", "both", "positions", "directions"):
        for space in fixtures.SPACES:
            setup = fixtures.setup(grouping)
            try:
                return case.component.bind(space, setup), space, setup
            except SetupError as error:
                errors.append(str(error))
    raise unmet(errors)


def _states(space: Space) -> np.ndarray:
    return fixtures.gaussians(space)[0]


def _scan(setup: Setup) -> Scan:
    return fixtures.scans(setup, fixtures.regular(1))[0]


@claim("likelihood.runs", _LIKELIHOOD)
def runs(case: Case) -> None:
    """States (n, d) give n log ratios that are finite or −inf, also for no state at all."""
    bound, space, setup = _bound(case)
    need(
        hasattr(bound, "sensors"), f"bind gave a {type(bound).__name__} without `sensors`, the numbers of the sensors whose fields it reads"
    )
    x = _states(space)
    for n in (len(x), 0):
        scan = _scan(setup)
        found = bound.log_ratio(x[:n], scan)
        kinds = sorted({s.kind for s in setup.sensors})
        need(
            found is not None,
            f"bind took a setup of sensors of kind {kinds}, and a scan of it with the fields {sorted(scan.fields)} gives None: "
            f"bind must refuse, by SetupError, a setup without the sensors that it reads",
        )
        need(np.shape(found) == (n,), f"{n} states give shape {np.shape(found)}; ({n},) is needed")
        need(not (np.isnan(found).any() or np.isposinf(found).any()), "a log ratio is NaN or +infinity")


@claim("likelihood.mutation", _LIKELIHOOD, ["likelihood.runs"])
def mutation(case: Case) -> None:
    """States are left as they came."""
    bound, space, setup = _bound(case)
    untouched(lambda x: bound.log_ratio(x, _scan(setup)), _states(space))


@claim("likelihood.batch", _LIKELIHOOD, ["likelihood.mutation"])
def batch(case: Case) -> None:
    """A state's ratio depends on the state and the scan, not on the states beside it."""
    bound, space, setup = _bound(case)
    x, scan = _states(space), _scan(setup)
    whole = np.asarray(bound.log_ratio(x, scan))
    alone = np.concatenate([bound.log_ratio(x[j : j + 1], scan) for j in range(len(x))])
    need(np.allclose(whole, alone, rtol=1e-9, atol=1e-12), "a state asked alone and among others has different ratios")


@claim("likelihood.silence", _LIKELIHOOD, ["likelihood.runs"])
def silence(case: Case) -> None:
    """A scan that searched nothing and holds no field says nothing: None."""
    bound, space, setup = _bound(case)
    found = bound.log_ratio(_states(space), fixtures.silent(setup, 0.1, False))
    need(found is None, f"a silent scan gives {type(found).__name__}; None is needed, or a tracker takes silence for evidence")


@claim("likelihood.peak", _LIKELIHOOD, ["likelihood.batch"])
def peak(case: Case) -> None:
    """One talker alone: where he is, is likelier than 200 places elsewhere are on average, and likelier than nobody."""
    bound, space, setup = _bound(case)
    talker = fixtures.talkers(np.zeros(1))[0, :1]
    scan = fixtures.scan(setup, 0.1, talker, np.random.default_rng(1), 0)
    rng = np.random.default_rng(2)
    places = np.concatenate([talker, rng.uniform(0.1, 0.9, (200, 3)) * fixtures.BOX_M[1]])
    x = np.zeros((201, len(space)))
    axes = [n for n in ("x_m", "y_m", "z_m") if n in space.names]
    x[:, space.index(*axes)] = places[:, : len(axes)]
    if not axes:
        unit = next(s for s in setup.sensors if s.kind == "direction")
        x[:, space.index("azimuth_rad", "elevation_rad")] = fixtures.measured_of(places, unit, setup.c_m_s)
    found = np.asarray(bound.log_ratio(x, scan))
    need(found[0] > 0, f"the talker's own place has the log ratio {found[0]:.3g}; above 0 is needed")
    need(
        found[0] > np.mean(found[1:]),
        f"the talker's own place has the log ratio {found[0]:.3g}, others {np.mean(found[1:]):.3g} on average",
    )


@claim("likelihood.focused", _LIKELIHOOD, ["likelihood.silence"])
def focused(case: Case) -> None:
    """Told where the target may be, it gives a function of later points, and the rows that it trusts, by sensor; of silence None."""
    bound, space, setup = _bound(case)
    if not hasattr(bound, "focused"):
        raise Skip("it has no focused; it reads a scan the same way wherever the target may be")
    x = _states(space)
    w = np.full(len(x), 1.0 / len(x))
    untouched(lambda a, b: bound.focused(a, b, _scan(setup)), x, w)
    focus = bound.focused(x, w, _scan(setup))
    for n in (len(x), 1, 0):
        found = np.asarray(focus.log_ratio(x[:n]))
        need(found.shape == (n,), f"{n} later points give shape {found.shape}; ({n},) is needed")
        need(not (np.isnan(found).any() or np.isposinf(found).any()), "a log ratio is NaN or +infinity")
    for q, z, R in focus.rows:
        dz = len(setup.sensors[q].space)
        need(
            np.shape(z) == (dz,) and np.shape(R) == (dz, dz),
            f"the row of sensor {q} has shapes {np.shape(z)} and {np.shape(R)}; ({dz},) and ({dz}, {dz}) are needed",
        )
    need(not focus.rows or focus.measurement is not None, "there are rows, and no measurement to compare them with")
    need(bound.focused(x, w, fixtures.silent(setup, 0.1, False)) is None, "a silent scan gives a focus; None is needed")


@claim("likelihood.foreign", _LIKELIHOOD, ["likelihood.runs"])
def foreign(case: Case) -> None:
    """A setup without the sensors that it reads is refused at bind by a SetupError that names both sides."""
    _, space, setup = _bound(case)
    refused(lambda strange: case.component.bind(space, strange), "bind", setup)
