"""What both command lines share."""

from __future__ import annotations

import argparse
from typing import NoReturn

import msgspec

from companion.config import CompanionConfig, VisionConfig

BAD_INPUT = 2
INTERRUPTED = 130


class OneLineParser(argparse.ArgumentParser):
    """An argument parser that answers bad input with one line."""

    def error(self, message: str) -> NoReturn:
        """End with what is wrong and where help is."""
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see {self.prog} --help\n")


def flight_options(p: argparse.ArgumentParser) -> None:
    """Add what both commands let people choose of a flight."""
    p.add_argument("--law", choices=("attitude", "velocity", "surfaces"), help="docking law")
    p.add_argument("--fusion", choices=("filter", "blend"), help="of GPS and vision: the filter, or the thesis' blend")
    p.add_argument("--pose", choices=("lhm", "glsdc"), help="pose solver")
    p.add_argument("--detector", choices=("lights", "corners"), help="what is looked for on the tanker")
    p.add_argument("--labeling", choices=("robust", "mutual_nearest"), help="which detection is which marker")
    p.add_argument("--vision", choices=("rv", "sv"), help="real or simulated vision (thesis 4.2.5)")


def flight_arguments(config: CompanionConfig) -> list[str]:
    """Return the options that make a configuration of its file fly as this one does."""
    return [
        "--law", config.guidance.law, "--fusion", config.fusion.method, "--pose", config.vision.solver,
        "--detector", config.vision.detector, "--labeling", config.vision.labeling.method,
        "--vision", config.vision.mode,
    ]  # fmt: skip


def with_flight_options(config: CompanionConfig, a: argparse.Namespace) -> CompanionConfig:
    """Return the configuration with what the command line says in place; a command without these says nothing."""
    replace = msgspec.structs.replace
    if getattr(a, "law", None) is not None:
        config = replace(config, guidance=replace(config.guidance, law=a.law))
    if getattr(a, "fusion", None) is not None:
        config = replace(config, fusion=replace(config.fusion, method=a.fusion))
    return replace(config, vision=_with_vision_options(config.vision, a))


def _with_vision_options(vision: VisionConfig, a: argparse.Namespace) -> VisionConfig:
    names = {"pose": "solver", "detector": "detector", "vision": "mode"}
    given = {field: v for name, field in names.items() if (v := getattr(a, name, None)) is not None}
    if getattr(a, "labeling", None) is not None:
        given["labeling"] = msgspec.structs.replace(vision.labeling, method=a.labeling)
    return msgspec.structs.replace(vision, **given)
