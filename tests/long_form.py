"""Size of the tests that try many examples or machines: some in the check, many with `make long-forms`."""

from hypothesis import settings


def size(check: int, long: int) -> int:
    """Return the number of examples or machines: `long` with the profile `long` of hypothesis, else `check`."""
    return long if settings.get_current_profile_name() == "long" else check
