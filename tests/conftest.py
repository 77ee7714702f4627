"""What holds for all tests. Its place also makes the modules beside it importable by them."""

from __future__ import annotations

from hypothesis import HealthCheck, settings

# No test may depend on how fast the machine is, nor leave a database behind.
settings.register_profile("slidectl", deadline=None, suppress_health_check=[HealthCheck.too_slow], database=None)
settings.load_profile("slidectl")
