"""How long to wait for an answer on a link whose delay nobody knows beforehand and that may change in flight."""

from __future__ import annotations

_BACK_OFF = 1.5
_PATIENT_S = 4.0
"""Without a measured reason for it nobody waits longer than this between two askings."""
_MANY = 6
"""After this many copies without an answer the link has become slow: that all of them were lost is less likely."""


class RoundTrip:
    """Smoothed round trip and its deviation, as TCP has them (RFC 6298). One for each vehicle, used by all it is asked.

    An answer to something that was sent once is measured. One to something that was repeated may belong to any of the
    copies (Karn's rule): it is only taken for the upper bound it is, when nothing better is known. Until the next
    answer that is clear, the longer wait stays.
    """

    def __init__(self, *, initial_s: float = 0.3, least_s: float = 0.045) -> None:
        self._least_s = least_s
        self._smooth_s: float | None = None
        self._deviation_s = 0.0
        self._wait_s = initial_s
        self._patience = 1.0

    @property
    def seconds(self) -> float:
        """The smoothed round trip, 0 as long as none was measured."""
        return self._smooth_s or 0.0

    @property
    def timeout_s(self) -> float:
        """Seconds after which an answer is overdue."""
        return min(max(self._wait_s * self._patience, self._least_s), max(_PATIENT_S, self._wait_s))

    def answered(self, since_first_s: float, times: int) -> None:
        """An answer came this long after the first of `times` sendings of its question."""
        if times == 1:
            self._measured(since_first_s)
        elif self._smooth_s is None or times > _MANY:
            self._smooth_s = None
            self._measured(since_first_s)

    def missed(self) -> None:
        """Wait half as long again next time: the link may have become slower."""
        self._patience = min(_BACK_OFF * self._patience, _PATIENT_S / self._least_s)

    def _measured(self, seconds: float) -> None:
        if self._smooth_s is None:
            self._smooth_s, self._deviation_s = seconds, seconds / 2
        else:
            self._deviation_s += 0.25 * (abs(self._smooth_s - seconds) - self._deviation_s)
            self._smooth_s += 0.125 * (seconds - self._smooth_s)
        self._wait_s = self._smooth_s + 4 * self._deviation_s
        self._patience = 1.0
