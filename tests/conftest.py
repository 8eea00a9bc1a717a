"""Shared by all tests."""

from hypothesis import settings

# A first call compiles kernels for seconds, and the machines are noisy: time is measured by `make bench`, not here.
settings.register_profile("project", deadline=None)
settings.load_profile("project")
