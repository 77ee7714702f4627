"""How well the scene is drawn: whether it has shadows, which a browser that draws by software pays for with half of its
frames, and how large a pixel is.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, NamedTuple

from slidectl.errors import UnknownName

if TYPE_CHECKING:
    from slidectl.extensions.viewing.page.page import Page

_CHOICES = ("auto", "on", "off")
_SEEN_S = 5.0
"""Wall seconds for which a browser counts after its last request: visible ones send one each second."""
_MOST_BROWSERS = 200
_LARGEST_RATIO = 4.0


class _Browser(NamedTuple):
    seen_at: float
    draws_by_software: bool
    pixel_ratio: float


class DrawingQuality:
    """The quality for all browsers, which see the same scene. Shadows are on, off, or on while no browser draws by
    software (auto).
    """

    def __init__(self, page: Page) -> None:
        self._page = page
        self.shadows = "auto"
        self.has_shadows = False
        self._browsers: dict[str, _Browser] = {}
        self._apply()

    @property
    def pixel_ratio(self) -> float:
        """The most pixels of a screen that a pixel of a page has in one of the browsers."""
        return max((one.pixel_ratio for one in self._browsers.values()), default=1.0)

    def seen(self, request: dict[str, Any]) -> None:
        """Note that a `browser` is there, whether it `draws_by_software`, and its `pixel_ratio`."""
        now = time.monotonic()
        name = str(request.get("browser", ""))[:40]
        if name and (name in self._browsers or len(self._browsers) < _MOST_BROWSERS):
            ratio = min(max(1.0, float(request.get("pixel_ratio", 1.0))), _LARGEST_RATIO)  # 1.0 for nan
            self._browsers[name] = _Browser(now, bool(request.get("draws_by_software", True)), ratio)
        self._browsers = {key: one for key, one in self._browsers.items() if now - one.seen_at < _SEEN_S}
        self._choose()

    def choose_shadows(self, choice: str) -> None:
        """Set the choice. Raises UnknownName."""
        if choice not in _CHOICES:
            raise UnknownName("choice of shadows", choice, list(_CHOICES))
        self.shadows = choice
        self._choose()

    def _choose(self) -> None:
        are_fast = bool(self._browsers) and not any(one.draws_by_software for one in self._browsers.values())
        wanted = self.shadows == "on" or (self.shadows == "auto" and are_fast)
        if wanted != self.has_shadows:
            self.has_shadows = wanted
            self._apply()

    def _apply(self) -> None:
        self._page.server.scene.configure_default_lights(cast_shadow=self.has_shadows)
