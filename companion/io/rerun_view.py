"""Looking at a recording: the layout of the viewer, the viewer itself, and pictures of it without a screen."""

from __future__ import annotations

import os
import shlex
import socket
import subprocess
import sys
import time
from pathlib import Path

import rerun.blueprint as rrb
import rerun_cli
from rerun.experimental import ViewerClient

from companion.config import ConfigError, WindowConfig

APPLICATION_ID = "refuel-companion"
LOOPBACK = "127.0.0.1"
BACKGROUND = (28, 34, 44)

SETTLE_S = 2.0
"""How long the viewer may take to draw the instant that it was sent to."""


def flight_blueprint(window: WindowConfig) -> rrb.Blueprint:
    """Return the layout: a page of the flight, and one of what the estimate is worth."""
    return rrb.Blueprint(
        rrb.Tabs(flight_page(window), trust_page(), active_tab=0),
        rrb.TimePanel(state=rrb.components.PanelState.Collapsed, timeline="sim_time"),
        rrb.BlueprintPanel(state=rrb.components.PanelState.Hidden),
        rrb.SelectionPanel(state=rrb.components.PanelState.Hidden),
    )


def flight_page(window: WindowConfig) -> rrb.Container:
    """Return scene and picture above, BR against the window below, phase and log at the foot."""
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=(-64.0, 38.0, 2.0), look_target=(-23.0, -1.0, 8.5), eye_up=(0.0, 0.0, -1.0)
    )
    scene = rrb.Spatial3DView(
        origin="world",
        name="Scene about the tanker",
        contents=["+ $origin/**", "- /world/uav/camera/image/**"],
        background=rrb.Background(color=BACKGROUND),
        line_grid=False,
        eye_controls=eye,
    )
    camera = rrb.Spatial2DView(origin="world/uav/camera", contents="world/uav/camera/image/**", name="Camera")
    operator = rrb.Spatial2DView(origin="operator/camera", name="Boom operator")
    br = [
        rrb.TimeSeriesView(
            origin=f"plots/br/{axis}",
            name=f"BR {axis} ({what}), m: ±{desired_m:.2f} desired, ±{limit_m:.2f} limit",
            axis_y=rrb.ScalarAxis(range=(-1.5 * limit_m, 1.5 * limit_m), zoom_lock=False),
            axis_x=whole_flight(),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightBottom, visible=axis == "x"),
        )
        for axis, what, desired_m, limit_m in zip(
            "xyz", ("forward", "right", "down"), window.desired_m, window.limit_m, strict=True
        )
    ]
    more = rrb.Tabs(
        plot("fusion", "Fusion", legend=True),
        plot("range", "Range"),
        plot("setpoint", "Setpoint"),
        plot("latency", "Latency, ms"),
    )
    return rrb.Vertical(
        rrb.Horizontal(scene, rrb.Tabs(camera, operator), column_shares=[3, 2]),
        rrb.Horizontal(*br, more),
        foot("/phase", "/trust"),
        row_shares=[5, 2.8, 1.6],
        name="Flight",
    )


def trust_page() -> rrb.Container:
    """Return protection per axis above, what the filter makes of its measurements below, bands and log at the foot."""
    protection = [
        rrb.TimeSeriesView(
            origin=f"plots/trust/{axis}",
            name=f"Protection level {axis}, m",
            axis_y=rrb.ScalarAxis(range=(0.0, 2.0), zoom_lock=False),
            axis_x=whole_flight(),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=axis == "x"),
        )
        for axis in "xyz"
    ]
    nis = rrb.TimeSeriesView(
        origin="plots/nis", name="NIS over degrees of freedom", axis_x=whole_flight(),
        axis_y=rrb.ScalarAxis(range=(0.0, 6.0), zoom_lock=False), plot_legend=rrb.Corner2D.RightTop,
    )  # fmt: skip
    return rrb.Vertical(
        rrb.Horizontal(*protection, nis),
        rrb.Horizontal(
            plot("filter/gps_bias", "GPS less truth, m", legend=True),
            plot("filter/boresight", "Boresight, mrad", legend=True),
            plot("filter/lag", "Lag of the datalink's stamps, ms"),
            plot("inputs", "Inputs come late by, ms", legend=True),
        ),
        foot("/phase", "/trust", "/health/**"),
        row_shares=[3, 3, 3],
        name="Trust",
    )


def whole_flight() -> rrb.TimeAxis:
    """Return a time axis from beginning to end."""
    ends = rrb.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rrb.TimeRange(ends, ends))


def plot(origin: str, name: str, *, legend: bool = False) -> rrb.TimeSeriesView:
    """Return a plot of the whole flight."""
    where = rrb.PlotLegend(rrb.Corner2D.RightTop, visible=legend)
    return rrb.TimeSeriesView(origin=f"plots/{origin}", name=name, axis_x=whole_flight(), plot_legend=where)


def foot(*bands: str) -> rrb.Container:
    """Return bands of states beside the log."""
    return rrb.Horizontal(
        rrb.StateTimelineView(origin="/", contents=list(bands), name="States", time_view=whole_flight()),
        rrb.TextLogView(origin="log", name="Log", columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])),
        column_shares=[3, 2],
    )


def recordings(run_dir: Path | str) -> list[Path]:
    """Return the .rrd files of a run; raises ConfigError when there is none."""
    files = [f for name in ("flight.rrd", "truth.rrd") if (f := Path(run_dir) / name).is_file()]
    if not files:
        msg = f"{run_dir}: neither flight.rrd nor truth.rrd here; give a run folder"
        raise ConfigError(msg)
    return files


def viewer_environment() -> dict[str, str]:
    """Return the environment for the viewer: as ours, without its reports to its makers."""
    return {**os.environ, "RERUN_ANALYTICS": "0"}


def viewer_binary() -> str:
    """Return the viewer that came with the SDK: the program itself, as its launcher would leave it behind."""
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    return str(Path(rerun_cli.__file__).with_name(name))


def open_viewer(run_dir: Path | str) -> int:
    """Open a run in the native viewer and wait until it is closed; return its exit code.

    Without a display raises ConfigError that says how to look from a browser.
    """
    files = [str(f) for f in recordings(run_dir)]
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        web = shlex.join([viewer_binary(), "--bind", LOOPBACK, "--web-viewer", *files])
        msg = f"no display for the viewer; in a browser instead: {web}"
        raise ConfigError(msg)
    command = [viewer_binary(), "--bind", LOOPBACK, "--port", "auto", *files]
    return subprocess.run(command, env=viewer_environment(), check=False).returncode


def screenshot(run_dir: Path | str, png: Path | str, time_s: float | None = None, size: str = "1600x900") -> None:
    """Write a picture of the viewer at an instant of ``sim_time`` (the end by default), without a screen.

    Needs a Vulkan driver; Mesa's software one will do (Debian: mesa-vulkan-drivers). Raises ConfigError when the
    viewer does not come up.
    """
    files = [str(f) for f in recordings(run_dir)]
    port = _free_port()
    command = [viewer_binary(), "--headless", "--bind", LOOPBACK, "--port", str(port)]
    viewer = subprocess.Popen(
        [*command, "--window-size", size, *files], env=viewer_environment(),
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        client = _connect(viewer, port)
        if time_s is None:
            client.set_time("sim_time", play_state="following")
        else:
            client.set_time("sim_time", duration=time_s, play_state="paused")
        time.sleep(SETTLE_S)
        client.save_screenshot(str(Path(png).resolve()))
    except (RuntimeError, ConnectionError) as error:
        reason = str(error).partition("\n")[0]
        msg = f"{png}: the viewer drew no picture ({reason})"
        raise ConfigError(msg) from None
    finally:
        viewer.kill()
        viewer.wait()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
        return port


def _connect(viewer: subprocess.Popen[bytes], port: int) -> ViewerClient:
    for _ in range(60):
        if viewer.poll() is not None:
            break
        try:
            client = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
            state = client.get_state()
            if state.active_recording is not None and not state.loading:
                return client
        except (RuntimeError, OSError):
            pass
        time.sleep(0.5)
    msg = "the viewer did not come up; does this machine have a Vulkan driver (Debian: mesa-vulkan-drivers)?"
    raise ConfigError(msg)
