"""What both command lines share."""

from __future__ import annotations

import argparse
from typing import NoReturn

import msgspec

from companion.config import VisionConfig

BAD_INPUT = 2
INTERRUPTED = 130


class OneLineParser(argparse.ArgumentParser):
    """An argument parser that answers bad input with one line."""

    def error(self, message: str) -> NoReturn:
        """End with what is wrong and where help is."""
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see {self.prog} --help\n")


def vision_options(p: argparse.ArgumentParser) -> None:
    """Add what both commands let people choose of the vision."""
    p.add_argument("--pose", choices=("lhm", "glsdc"), help="pose solver")
    p.add_argument("--detector", choices=("lights", "corners"), help="what is looked for on the tanker")
    p.add_argument("--labeling", choices=("robust", "mutual_nearest"), help="which detection is which marker")
    p.add_argument("--vision", choices=("rv", "sv"), help="real or simulated vision (thesis 4.2.5)")


def with_vision_options(vision: VisionConfig, a: argparse.Namespace) -> VisionConfig:
    """Return the configuration with what the command line says in place; a command without these says nothing."""
    names = {"pose": "solver", "detector": "detector", "vision": "mode"}
    given = {field: v for name, field in names.items() if (v := getattr(a, name, None)) is not None}
    if getattr(a, "labeling", None) is not None:
        given["labeling"] = msgspec.structs.replace(vision.labeling, method=a.labeling)
    return msgspec.structs.replace(vision, **given)
