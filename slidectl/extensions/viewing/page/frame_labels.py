"""The names of links in the scene. Each browser gets those that do not overlap as seen by its own camera."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from slidectl.extensions.viewing.drawn_scene import DrawnScene
from slidectl.rotations import matrix, xyzw

if TYPE_CHECKING:
    from viser import CameraHandle, ClientHandle, LabelHandle

    from slidectl.extensions.viewing.page.page import Page
    from slidectl.measures import Array

_FONT_PX = 12.0
"""Sizes of viser's labels, in pixels of the page."""
_LETTER_PX = 7.0
_MARGIN_PX = 5.0
_ANCHORS = {"bottom-center": (-0.5, -1.0), "top-center": (-0.5, 0.0), "center-left": (0.0, -0.5),
            "center-right": (-1.0, -0.5)}  # fmt: skip
"""Where a label may lie at its frame, the best first -> its left upper corner, in widths and heights."""


class FrameLabels:
    """The labels of all browsers."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._labels: dict[int, dict[str, LabelHandle]] = {}
        """Browser -> ROBOT::LINK -> label."""

    def clear(self) -> None:
        """Remove all labels."""
        for labels in self._labels.values():
            for label in labels.values():
                label.remove()
        self._labels.clear()

    def update(self, scene: DrawnScene, pixel_ratio: float) -> None:
        """Choose and place the labels for where the cameras and the links are now.

        `pixel_ratio` is how many pixels of a camera's picture a pixel of the page has.
        """
        links = [link for link in scene.poses if not link.endswith("::world")]
        places = np.array([scene.poses[link][0] for link in links]).reshape(-1, 3)
        browsers = self._page.server.get_clients()
        for gone in self._labels.keys() - browsers.keys():
            del self._labels[gone]
        for key, browser in browsers.items():
            with browser.atomic():
                self._place(browser, self._labels.setdefault(key, {}), links, places, pixel_ratio)

    def _place(
        self, browser: ClientHandle, labels: dict[str, Any], links: list[str], places: Array, pixel_ratio: float
    ) -> None:
        if not 0.0 < browser.camera.fov < math.pi:  # a browser may send any number
            return
        pixels, depths = _seen(browser.camera, places)
        taken = np.empty((0, 4))
        for index in np.argsort(depths, kind="stable"):
            link = links[index]
            text, label = link.partition("::")[2], labels.get(link)
            anchor = None
            if math.isfinite(depths[index]):
                size = (np.array((_LETTER_PX * len(text), _FONT_PX)) + 2 * _MARGIN_PX) * pixel_ratio
                # A label stays where it is as long as it can.
                first = [label.anchor] if label is not None and label.visible else []
                for one in [*first, *_ANCHORS]:
                    corner = pixels[index] + size * _ANCHORS[one]
                    box = np.concatenate((corner, corner + size))
                    overlaps = (taken[:, :2] < box[2:]).all(axis=1) & (box[:2] < taken[:, 2:]).all(axis=1)
                    if not overlaps.any():
                        anchor, taken = one, np.vstack((taken, box))
                        break
            if anchor is None:
                if label is not None:
                    label.visible = False
            elif label is None:
                path = f"/labels/{link.replace('::', '.').replace('/', '_')}"
                labels[link] = browser.scene.add_label(path, text, anchor=anchor, position=places[index])
            else:
                label.anchor, label.position, label.visible = anchor, places[index], True


def _seen(camera: CameraHandle, places: Array) -> tuple[Array, Array]:
    """Where points (n x 3, m) are in the picture of a camera (n x 2, px from its left upper corner), and how far before
    it (n, m); behind it they are infinitely far.
    """
    turn = np.array(matrix(xyzw(tuple(camera.wxyz.tolist()))))
    right, down, ahead = ((places - camera.position) @ turn).T
    is_before = ahead > camera.near
    depths = np.where(is_before, ahead, math.inf)
    scale = camera.image_height / 2 / math.tan(camera.fov / 2)
    pixels = np.column_stack((right, down)) * (scale / np.where(is_before, ahead, 1.0))[:, None]
    return pixels, depths
