"""What an autopilot's boot clock shows of a restart. Pure."""

from __future__ import annotations

_LATE_MS = 2000
"""A message may be this late, or a restarted autopilot this early, before its clock proves anything."""
_WRAP_MS = 2**31
"""`time_boot_ms` is a uint32: a larger step back is the counter wrapping after 49 days, not a restart."""


def has_restarted(before_ms: int, boot_ms: int, after_s: float) -> bool:
    """Return whether an autopilot restarted between two times of its clock, `time_boot_ms`, heard `after_s` apart.

    Its clock ran backwards, and it started after it was heard before: neither a datagram that comes late nor a clock
    that was set back looks like that.
    """
    return _LATE_MS < before_ms - boot_ms < _WRAP_MS and boot_ms <= after_s * 1000 + _LATE_MS
