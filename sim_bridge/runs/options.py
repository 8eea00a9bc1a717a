"""Command line of many flights: ``sim-bridge consistency``, ``accuracy`` and ``integrity``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

PROCESSES = 2
"""As many as the machine has cores, unless told otherwise: a flight keeps one busy."""

FIRST_SEED = 2001
"""Reported, and never tuned on."""


def options(commands: Any, action: Callable[[argparse.Namespace], int]) -> None:
    """Add the three commands to the subparsers of a command line."""
    c = commands.add_parser("consistency", help="many flights: whether the estimate is as good as it says (NEES, NIS)")
    _flights(c, 100)
    _common(c, FIRST_SEED, action)
    c.add_argument("--turbulence", choices=("light", "moderate"), default="light", help="default: light")
    c.add_argument("--fusion", choices=("filter", "blend"), help="fusion of GPS and vision")
    a = commands.add_parser("accuracy", help="error of the fused position in the hold, with GPS and without: a table")
    a.add_argument("--quick", action="store_true", help="two seeds, by detections only")
    _common(a, 1, action)
    i = commands.add_parser("integrity", help="many flights with faults: endings, false \"may dock\", Stanford plot")
    _flights(i, 500)
    _common(i, FIRST_SEED, action)


def _flights(p: argparse.ArgumentParser, count: int) -> None:
    p.add_argument("--flights", type=int, default=count, metavar="N", help=f"how many (default: {count})")


def _common(p: argparse.ArgumentParser, first_seed: int, action: Callable[[argparse.Namespace], int]) -> None:
    p.add_argument("--first-seed", type=int, default=first_seed, metavar="SEED",
                   help=f"the flights have the seeds from this one on (default: {first_seed})")
    p.add_argument("--processes", type=int, default=PROCESSES, metavar="N",
                   help=f"how many fly at the same time (default: {PROCESSES})")
    p.add_argument("--out", metavar="DIR", help="write table and picture to this folder as well")
    p.set_defaults(action=action)
