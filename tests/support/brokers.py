"""Stand-ins for the broker, for an API whose cases the test ends itself."""


class SilentBroker:
    """Takes messages and forgets them."""

    def send(self, identifier: str, queue: str = "interactive") -> None: ...

    def waiting(self, queue: str) -> int:
        return 1

    def ping(self) -> None: ...


class MemoryBroker:
    """Remembers messages; answers unless it is down."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, str]] = []
        self.down = False

    def send(self, identifier: str, queue: str = "interactive") -> None:
        self.ping()
        self.messages.append((identifier, queue))

    def waiting(self, queue: str) -> int:
        return sum(sent_to == queue for _, sent_to in self.messages)

    def ping(self) -> None:
        if self.down:
            raise ConnectionError("connection refused")
