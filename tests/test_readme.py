"""What the README promises by name exists."""

import re
from pathlib import Path

from companion.guidance.modes import diagram

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_phase_diagram_is_the_table():
    assert diagram() in README


def test_files_and_folders_that_are_named_exist():
    named = set(re.findall(r"`((?:companion|sim_bridge|firmware_configs|docs)/[\w./-]*)`", README))
    named |= set(re.findall(r"\]\((docs/[\w.]+)\)", README))
    assert len(named) > 15
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_make_targets_that_are_named_exist():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^make ([\w-]+)", README, re.MULTILINE)) | set(re.findall(r"`make ([\w-]+)", README))
    assert {"sitl", "test", "fly", "view", "bench", "help"} <= targets
    assert [t for t in sorted(targets) if not re.search(rf"^{t}:", makefile, re.MULTILINE)] == []
