"""Whom a vehicle belongs to where several services command one fleet: only one of them may send to it at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from skyfolio.api.store.leases import Leases


class VehicleRights:
    """What this service's leases say of vehicles. leases: None where no other service commands the fleet."""

    def __init__(self, leases: Leases | None) -> None:
        self._leases = leases

    @property
    def may_send(self) -> Callable[[int], bool] | None:
        """Return what tells whether a frame may leave for a system id now (`LinkOptions.may_send`)."""
        return None if self._leases is None else self._leases.may_send

    def is_of_another(self, system_id: int) -> bool:
        """Return whether another service has this vehicle."""
        return self._leases is not None and self._leases.book.having(system_id) is not None

    def owner(self, system_id: int) -> str | None:
        """Return, in words, which operation of which other service has this vehicle; None if none has."""
        lease = None if self._leases is None else self._leases.book.having(system_id)
        return None if lease is None else f"it flies operation {lease.operation_id} of service {lease.name!r}"

    def until_s(self, system_ids: Iterable[int]) -> float | None:
        """Return until which second of CLOCK_BOOTTIME we may send to these; None: no other service ever may."""
        return None if self._leases is None else self._leases.until_s(system_ids)
