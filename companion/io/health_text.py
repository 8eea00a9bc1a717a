"""How the health of a stage is told to people."""

from __future__ import annotations

from companion.messages import StageHealth


def stage_state(stage: StageHealth) -> str:
    """Return the band's word for a stage."""
    if not stage.present:
        return "absent"
    if not stage.enabled:
        return "not used"
    return "well" if stage.healthy else "ill"


def stage_line(before: StageHealth | None, now: StageHealth) -> str:
    """Return what to tell people of a stage that has changed, or nothing: a stage that is not used does not count."""
    was_ill = before is not None and before.enabled and not before.healthy
    is_ill = now.enabled and not now.healthy
    if is_ill and (not was_ill or (before is not None and before.detail != now.detail)):
        return f"{now.name} fails{': ' if now.detail else ''}{now.detail}"
    return f"{now.name} is well again" if was_ill and not is_ill else ""
