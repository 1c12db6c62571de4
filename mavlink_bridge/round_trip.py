"""How long to wait for an answer on a link whose delay is not known beforehand and may change in flight."""

from __future__ import annotations

from math import inf

_BACK_OFF = 1.5
_PATIENT_S = 2.0
"""Unless a measurement requires it, no wait between two sendings is longer than this."""
_MANY = 6
"""After this many copies without an answer the link has become slow: that all of them were lost is less likely."""


_IN_A_ROW = 3
"""So many answers that take as long as before show that the link has not become slow."""


class RoundTrip:
    """The smoothed round trip and its deviation, as in TCP (RFC 6298): one for each vehicle, for all its requests.

    An answer to a message that was sent once is measured. One to a message that was repeated may belong to any of the
    copies (Karn's rule): it is only used as the upper bound it is, of the wait, and of the round trip if nothing better
    is known. Until the next unambiguous answer the longer wait stays, as far as that bound permits. If then some
    answers in a row take as long as before the bound, that holds again, as the bound would take dozens of them to fade:
    a vehicle that hung for two seconds is soon asked again as quickly as before. Late answers to earlier copies take
    any time, and prove nothing.
    """

    def __init__(self, *, initial_s: float = 0.3, least_s: float = 0.045) -> None:
        self._least_s = least_s
        self._smooth_s: float | None = None
        self._deviation_s = 0.0
        self._wait_s = initial_s
        self._patience = 1.0
        self._alive_since_s = -inf
        self._before: tuple[float, float] | None = None
        """Round trip and deviation before a bound replaced them; None once there is something better than the bound."""
        self._as_before = 0
        """How many answers in a row took as long as before the bound."""

    @property
    def seconds(self) -> float:
        """Return the smoothed round trip, 0 until one was measured."""
        return self._smooth_s or 0.0

    @property
    def timeout_s(self) -> float:
        """Return the seconds after which an answer is overdue."""
        return min(max(self._wait_s * self._patience, self._least_s), max(_PATIENT_S, self._wait_s))

    def answered(self, first_s: float, now_s: float, times: int) -> None:
        """Take in an answer that came at `now_s` to the first of `times` sendings, at `first_s`, or to a later one.

        One that was first sent before a dead link carried messages again measures nothing.
        """
        if first_s < self._alive_since_s:
            return
        if times == 1:
            self._measured(now_s - first_s)
            self._compare(now_s - first_s)
            return
        self._patience = max(min(self._patience, (now_s - first_s) / max(self._wait_s, self._least_s)), 1.0)
        if self._smooth_s is None or times > _MANY:
            if self._before is None and self._smooth_s is not None:
                self._before = self._smooth_s, self._deviation_s
            self._as_before = 0
            self._smooth_s = now_s - first_s
            self._deviation_s = self._smooth_s / 8  # it took no longer
            self._wait_s = self._smooth_s + 4 * self._deviation_s

    def missed(self) -> None:
        """Wait half as long again next time: the link may have become slower."""
        self._patience = min(_BACK_OFF * self._patience, _PATIENT_S / self._least_s)

    def heard_again(self, now_s: float) -> None:
        """Take in that the link was dead and carries messages again: what was missed meanwhile was lost, not slow."""
        self._patience = 1.0
        self._alive_since_s = now_s

    def _compare(self, seconds: float) -> None:
        """Return to what was known before a bound once some answers in a row fit that."""
        if self._before is None:
            return
        smooth_s, deviation_s = self._before
        fits = smooth_s / 2 <= seconds <= max(smooth_s + 4 * deviation_s, self._least_s)
        self._as_before = self._as_before + 1 if fits else 0
        if self._as_before == _IN_A_ROW:
            self._smooth_s, self._deviation_s = self._before
            self._wait_s, self._before = smooth_s + 4 * deviation_s, None

    def _measured(self, seconds: float) -> None:
        if self._smooth_s is None:
            self._smooth_s, self._deviation_s = seconds, seconds / 2
        else:
            self._deviation_s += 0.25 * (abs(self._smooth_s - seconds) - self._deviation_s)
            self._smooth_s += 0.125 * (seconds - self._smooth_s)
        self._wait_s = self._smooth_s + 4 * self._deviation_s
        self._patience = 1.0
