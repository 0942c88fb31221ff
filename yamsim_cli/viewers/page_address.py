from __future__ import annotations

import ipaddress
from dataclasses import dataclass

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class PageAddress:
    """Network address of a browser page.

    Attributes:
        port: to listen on; 0 chooses an unused one.
        host: an address or name of this machine; `0.0.0.0` for all addresses.
    """

    port: int = 0
    host: str = LOOPBACK

    @property
    def is_private(self) -> bool:
        """Whether only users of this machine can reach the page."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    @property
    def url_host(self) -> str:
        """Host in a URL for a browser on this machine."""
        if self.host in ("0.0.0.0", "::"):
            return LOOPBACK
        return f"[{self.host}]" if ":" in self.host else self.host
