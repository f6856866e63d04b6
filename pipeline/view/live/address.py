"""Where the live view is served: an address and a port that are free."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass

DEFAULT_ADDRESS = "127.0.0.1:8080"
PORTS_TRIED = 20  # from the wanted one on, where others are taken


@dataclass(frozen=True)
class Address:
    host: str
    port: int  # 0: any

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @property
    def is_local(self) -> bool:
        """Whether only this machine reaches it."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"


def address_of(text: str, where: str) -> Address:
    """From HOST:PORT. ValueError, naming `where`, for anything else."""
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not host or not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise ValueError(f"{where}: expected HOST:PORT such as {DEFAULT_ADDRESS}, found {text}")
    return Address(host, int(port))
