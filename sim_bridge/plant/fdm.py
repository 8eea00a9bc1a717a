"""One JSBSim aircraft behind SI units: the only file that knows JSBSim, feet and slugs.

Rules
-----
* The step is set before the model is loaded: JSBSim discretises at load.
* The ground is flat and does not turn (``aircraft/flat_earth.xml``), so that ``ned`` is the same everywhere and
  position is the trapezoidal integral of ``v_ned``; JSBSim's own latitude and longitude are not used.
* A function may name a property that nobody has: JSBSim notices when it first wants its value, and aborts the process
  when it lets go of such a model. ``Fdm`` looks through the file right after loading.
* JSBSim says nothing when a state becomes NaN, or runs away on the way there: ``step`` looks and raises ``PlantError``.
* Inputs and gusts that are set act from the next ``step`` on: its forces are taken at the end of the step and move the
  aircraft in the one after it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import jsbsim
import numpy as np
from jsbsim._jsbsim import LogExceptionError

from companion.config import Vec3
from companion.geometry import GRAVITY_M_S2, Mat
from sim_bridge.truth import BodyState

ROOT = Path(__file__).resolve().parent.parent / "aircraft"
FT = 0.3048
LBF = 4.4482216152605
SLUG_FT3 = 515.3788183932
"""kg/m3 in one slug per cubic foot."""

WILD_M_S, WILD_RAD_S = 3000.0, 100.0
"""No aircraft of ours flies faster or turns faster: what does is on its way to infinity."""

STATE = (
    "velocities/v-north-fps",
    "velocities/v-east-fps",
    "velocities/v-down-fps",
    "attitude/phi-rad",
    "attitude/theta-rad",
    "attitude/psi-rad",
    "velocities/p-rad_sec",
    "velocities/q-rad_sec",
    "velocities/r-rad_sec",
)
GUST = ("atmosphere/gust-north-fps", "atmosphere/gust-east-fps", "atmosphere/gust-down-fps")
ROTARY_GUST = ("gust/p-rad_sec", "gust/q-rad_sec", "gust/r-rad_sec")
TRANSFERRED = "inertia/pointmass-weight-lbs[0]"
BOOM_FORCE = tuple(f"external_reactions/boom/{name}" for name in ("magnitude", "x", "y", "z"))
BOOM_AT = tuple(f"external_reactions/boom/location-{axis}-in" for axis in "xyz")
INCH = 0.0254
FORCE = ("forces/fbx-total-lbs", "forces/fby-total-lbs", "forces/fbz-total-lbs")
V_AIR = ("velocities/u-aero-fps", "velocities/v-aero-fps", "velocities/w-aero-fps")
UVW_DOT = ("accelerations/udot-ft_sec2", "accelerations/vdot-ft_sec2", "accelerations/wdot-ft_sec2")
NAMES_A_PROPERTY = {"p", "property", "independentVar"}
"""Elements whose text is the name of a property that a function reads (or that ``<property value=...>`` makes)."""
PQR_DOT = ("accelerations/pdot-rad_sec2", "accelerations/qdot-rad_sec2", "accelerations/rdot-rad_sec2")


class PlantError(RuntimeError):
    """The simulated aircraft cannot go on: a state or command that is not a number, or a model that does not load."""


@dataclass(frozen=True, slots=True)
class InitialCondition:
    """Where an aircraft starts: altitude of the origin is added to ``p_ned_m``; body velocity is inertial."""

    p_ned_m: tuple[float, float, float]
    v_body_m_s: tuple[float, float, float]
    yaw_pitch_roll_rad: tuple[float, float, float]
    omega_body_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Fdm:
    """One aircraft; ``inputs`` names the properties that ``set_inputs`` writes, in that order."""

    def __init__(self, model: str, inputs: Iterable[str], dt_s: float, origin_altitude_m: float) -> None:
        """Load ``aircraft/<model>``; raises PlantError when it does not load, or uses properties that do not exist."""
        jsbsim.set_logger(jsbsim.DefaultLogger(jsbsim.LogLevel.WARN))
        self._exec = jsbsim.FGFDMExec(str(ROOT))
        self._exec.set_debug_level(0)
        self.model = model
        self._dt_s = dt_s
        self._origin_altitude_m = origin_altitude_m
        self._exec.set_dt(dt_s)
        self._load(ROOT / "aircraft" / model / f"{model}.xml")
        self._set = tuple(self._node(name).set_double_value for name in inputs)
        self._set_gust = tuple(self._node(name).set_double_value for name in GUST)
        self._get_state = tuple(self._node(name).get_double_value for name in STATE)
        self._get_rates = tuple(self._node(name).get_double_value for name in (*UVW_DOT, *PQR_DOT))
        self._get_density = self._node("atmosphere/rho-slugs_ft3").get_double_value
        self._get_felt = tuple(self._node(name).get_double_value for name in (*FORCE, *V_AIR))
        self._set_rotary = tuple(self._node(name).set_double_value for name in ROTARY_GUST)
        self._set_transferred = self._node(TRANSFERRED).set_double_value
        self._set_force: tuple[Callable[[float], object], ...] = ()
        self._empty_kg = float(self._exec["inertia/mass-slugs"]) * LBF / FT
        self._mass_kg = self._empty_kg
        self.span_m = float(self._exec["metrics/bw-ft"]) * FT
        self.v_n = self.v_e = self.v_d = 0.0
        self.roll = self.pitch = self.yaw = 0.0
        self.p = self.q = self.r = 0.0
        self.p_n = self.p_e = self.p_d = 0.0

    def _load(self, path: Path) -> None:
        used = properties_used(read_xml(path)[1])
        try:
            loaded = self._exec.load_planet(str(ROOT / "flat_earth.xml"), False) and self._exec.load_model(self.model)
        except (LogExceptionError, jsbsim.BaseError):  # XML without what JSBSim must have
            loaded = False
        nodes = self._exec.get_property_manager()
        missing = [name for name in used if not name or nodes.get_node(name) is None]
        for name in filter(None, missing):  # or JSBSim aborts when it lets go of the functions that read them
            self._exec[name] = 0.0
        if not loaded:
            msg = f"JSBSim cannot load aircraft {self.model!r} from {path}; what it says is above"
            raise PlantError(msg)
        if missing:
            msg = f"{path}: property {missing[0]!r} is used, but neither this file nor JSBSim has it"
            raise PlantError(msg)

    def _node(self, name: str) -> jsbsim.FGPropertyNode:
        node = self._exec.get_property_manager().get_node(name)
        if node is None:
            msg = f"aircraft {self.model!r} has no property {name!r}"
            raise PlantError(msg)
        return node

    @property
    def mass_kg(self) -> float:
        """Mass of the aircraft."""
        return self._mass_kg

    def reset(self, ic: InitialCondition) -> None:
        """Put the aircraft at ``ic``; inputs keep their values. Raises PlantError when JSBSim refuses."""
        ex = self._exec
        ex["ic/lat-geod-deg"] = 0.0
        ex["ic/long-gc-deg"] = 0.0
        ex["ic/h-sl-ft"] = (self._origin_altitude_m - ic.p_ned_m[2]) / FT
        yaw, pitch, roll = ic.yaw_pitch_roll_rad
        ex["ic/phi-rad"], ex["ic/theta-rad"], ex["ic/psi-true-rad"] = roll, pitch, yaw
        for name, value in zip(("ic/u-fps", "ic/v-fps", "ic/w-fps"), ic.v_body_m_s, strict=True):
            ex[name] = value / FT
        for name, value in zip(("ic/p-rad_sec", "ic/q-rad_sec", "ic/r-rad_sec"), ic.omega_body_rad_s, strict=True):
            ex[name] = value
        if not self._ran(ex.run_ic):
            msg = f"JSBSim cannot start aircraft {self.model!r} from {ic}"
            raise PlantError(msg)
        self.p_n, self.p_e, self.p_d = ic.p_ned_m
        self._read()

    def set_inputs(self, values: Iterable[float]) -> None:
        """Write the inputs (JSBSim's units of each property)."""
        for set_value, value in zip(self._set, values, strict=True):
            set_value(value)

    def set_gust(self, north_m_s: float, east_m_s: float, down_m_s: float) -> None:
        """Set the velocity of the air."""
        n, e, d = self._set_gust
        n(north_m_s / FT)
        e(east_m_s / FT)
        d(down_m_s / FT)

    def set_rotary_gust(self, p_rad_s: float, q_rad_s: float, r_rad_s: float) -> None:
        """Set how the air turns about the aircraft's forward, right and down axes."""
        p, q, r = self._set_rotary
        p(p_rad_s)
        q(q_rad_s)
        r(r_rad_s)

    def set_transferred(self, fuel_kg: float) -> None:
        """Set the fuel got in flight (negative: given); mass and inertia follow in the next step."""
        self._set_transferred(fuel_kg * GRAVITY_M_S2 / LBF)
        self._mass_kg = self._empty_kg + fuel_kg

    def set_boom_force(self, force_body_n: tuple[float, float, float]) -> None:
        """Set what the boom does to the receptacle (N, body axes); raises PlantError for an aircraft without one."""
        if not self._set_force:
            self._set_force = tuple(self._node(name).set_double_value for name in BOOM_FORCE)
        x, y, z = force_body_n
        size = math.sqrt(x * x + y * y + z * z)
        direction = (x / size, y / size, z / size) if size > 0.0 else (1.0, 0.0, 0.0)
        for set_value, value in zip(self._set_force, (size / LBF, *direction), strict=True):
            set_value(value)

    def set_receptacle(self, at_frd_m: tuple[float, float, float]) -> None:
        """Say where the boom's force acts; raises PlantError for an aircraft without a receptacle."""
        x, y, z = at_frd_m
        # JSBSim's structural axes point aft, right and up.
        for name, value in zip(BOOM_AT, (-x, y, -z), strict=True):
            self._node(name).set_double_value(value / INCH)

    def scale_coefficient(self, name: str, factor: float) -> None:
        """Multiply the aerodynamic coefficient ``coef/name``; raises PlantError when the aircraft has none."""
        if not re.fullmatch(r"\w+", name):  # no path out of coef/
            msg = f"aircraft {self.model!r} has no coefficient {name!r}"
            raise PlantError(msg)
        node = self._node(f"coef/{name}")
        node.set_double_value(node.get_double_value() * factor)

    def step(self) -> None:
        """Advance one step; raises PlantError when a state is not finite or beyond any flight."""
        v_n, v_e, v_d = self.v_n, self.v_e, self.v_d
        running = self._ran(self._exec.run)
        self._read()
        half = 0.5 * self._dt_s
        self.p_n += half * (v_n + self.v_n)
        self.p_e += half * (v_e + self.v_e)
        self.p_d += half * (v_d + self.v_d)
        if not running:
            msg = f"JSBSim stopped aircraft {self.model!r}"
            raise PlantError(msg)

    def _ran(self, run: Callable[[], bool]) -> bool:
        try:
            return run()
        except (LogExceptionError, jsbsim.BaseError) as error:
            msg = f"JSBSim stopped aircraft {self.model!r}: {' '.join(str(error).split())}"
            raise PlantError(msg) from None

    def _read(self) -> None:
        v_n, v_e, v_d, self.roll, self.pitch, self.yaw, self.p, self.q, self.r = [get() for get in self._get_state]
        self.v_n, self.v_e, self.v_d = v_n * FT, v_e * FT, v_d * FT
        speed2 = self.v_n * self.v_n + self.v_e * self.v_e + self.v_d * self.v_d
        rate2 = self.p * self.p + self.q * self.q + self.r * self.r
        total = speed2 / WILD_M_S**2 + rate2 / WILD_RAD_S**2 + 1e-9 * (self.roll + self.pitch + self.yaw)
        if total < 1.0:  # also false for NaN
            return
        how = "have run away" if math.isfinite(total) else "are no longer finite"
        msg = f"flight dynamics of {self.model!r} {how} ({math.sqrt(speed2):.3g} m/s, {math.sqrt(rate2):.3g} rad/s)"
        raise PlantError(msg)

    def motion(self) -> tuple[Vec3, Vec3, Vec3, Vec3]:
        """Return position and velocity in ``ned``, yaw, pitch and roll, and body rates (m, m/s, rad, rad/s)."""
        return (
            (self.p_n, self.p_e, self.p_d), (self.v_n, self.v_e, self.v_d),
            (self.yaw, self.pitch, self.roll), (self.p, self.q, self.r),
        )  # fmt: skip

    def accelerations(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return the rates of change of body velocity (m/s2, in turning axes) and of p, q, r (rad/s2)."""
        u, v, w, p, q, r = [get() for get in self._get_rates]
        return (u * FT, v * FT, w * FT), (p, q, r)

    def rotation(self) -> Mat:
        """Return ``R_ned_body``."""
        cps, sps = math.cos(self.yaw), math.sin(self.yaw)
        cth, sth = math.cos(self.pitch), math.sin(self.pitch)
        cph, sph = math.cos(self.roll), math.sin(self.roll)
        # Row by row in one tuple, because numpy takes longer over nested lists.
        return np.array((
            cth * cps, sph * sth * cps - cph * sps, cph * sth * cps + sph * sps,
            cth * sps, sph * sth * sps + cph * cps, cph * sth * sps - sph * cps,
            -sth, sph * cth, cph * cth,
        )).reshape(3, 3)

    def state(self, t_ns: int) -> BodyState:
        """Return everything about this instant."""
        fx, fy, fz, u, v, w = [get() for get in self._get_felt]
        mass_kg = self._mass_kg
        return BodyState(
            t_ns=t_ns,
            p_ned_m=np.array((self.p_n, self.p_e, self.p_d)),
            v_ned_m_s=np.array((self.v_n, self.v_e, self.v_d)),
            R_ned_body=self.rotation(),
            omega_body_rad_s=np.array((self.p, self.q, self.r)),
            specific_force_body_m_s2=np.array((fx * LBF / mass_kg, fy * LBF / mass_kg, fz * LBF / mass_kg)),
            v_air_body_m_s=np.array((u * FT, v * FT, w * FT)),
        )

    def air_density_kg_m3(self) -> float:
        """Return the density of the air at the aircraft."""
        return float(self._get_density()) * SLUG_FT3

    def speed_of_sound_m_s(self) -> float:
        """Return the speed of sound at the aircraft."""
        return float(self._exec["atmosphere/a-fps"]) * FT


def read_xml(path: Path) -> tuple[str, ET.Element]:
    """Return the text and the root of an aircraft's file; raises PlantError that names it."""
    try:
        text = path.read_text(encoding="utf-8")
        return text, ET.fromstring(text)
    except OSError as error:
        msg = f"cannot load aircraft '{path.stem}': {path}: cannot be read ({error.strerror})"
    except UnicodeDecodeError as error:
        byte = f"byte {error.start} is 0x{error.object[error.start]:02x}"
        msg = f"cannot load aircraft '{path.stem}': {path}: not UTF-8 ({byte})"
    except ET.ParseError as error:
        msg = f"cannot load aircraft '{path.stem}': {path}: not an XML file ({error})"
    raise PlantError(msg)


def properties_used(file: ET.Element) -> list[str]:
    """Return the names of the properties that the functions of an aircraft file read, in its order, each once."""
    read = [e for e in file.iter() if e.tag in NAMES_A_PROPERTY and "value" not in e.attrib]
    return list(dict.fromkeys((e.text or "").strip().removeprefix("-") for e in read))
