"""A short recorded flight that the study's tests share: flying it takes seconds."""

from functools import lru_cache

from sim_bridge.study.recording import record

SEED = 1001


@lru_cache(maxsize=2)
def recorded(mode, seconds=24.0):
    return record(mode, SEED, seconds)
