"""What an autopilot sends to everybody beside its streams: STATUSTEXTs, and messages out of turn."""

from pymavlink.dialects.v20 import ardupilotmega as dialect

from skyfolio.sim.wire import Message, texts


class Outbox:
    """Messages that wait until the autopilot's next turn to send."""

    def __init__(self) -> None:
        self._messages: list[Message] = []
        self._texts = 0

    def __len__(self) -> int:
        return len(self._messages)

    def send_text(self, words: str, severity: int = dialect.MAV_SEVERITY_INFO) -> None:
        """Add a STATUSTEXT of a MAV_SEVERITY, in parts where it is longer than 50 bytes."""
        self._texts = self._texts % 0xFFFF + 1
        self._messages += texts(words, severity, self._texts)

    def add(self, message: Message | None) -> None:
        """Add a message; None, which is what a vehicle without such a message builds, adds nothing."""
        if message is not None:
            self._messages.append(message)

    def take(self) -> list[Message]:
        """Return everything that waits, oldest first, and forget it."""
        messages, self._messages = self._messages, []
        return messages

    def clear(self) -> None:
        """Forget everything that waits, as a reboot does."""
        self._messages.clear()
