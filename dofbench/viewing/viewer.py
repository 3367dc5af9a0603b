"""The viewer in the browser, on viser: each browser has its own camera, lens and choice of picture.

A picture is made at low resolution while something changes, so that it follows the hand, and at full quality once all
has been at rest for a moment.
"""

from __future__ import annotations

import io
import math
import threading
import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.lens import ApertureShape
from dofbench.viewing.keyframes import Keyframe, write_keyframes
from dofbench.viewing.picture import LAYERS, Look, Shown, at_photograph, fitting, picture
from dofbench.viewing.subject import Photograph, Subject

if TYPE_CHECKING:
    import viser

_FRAME = 1 / 18  # s, aim for a picture while something moves: 15 a second, and room for sending it
_REST = 0.25  # s without a change after which the full picture is made
_LOOK = 1.0  # s between two looks for something new of a running training
_LEAST = 128  # px, least width of a picture
_POINT = 0.005  # size of a point, in its distance from the cameras: a few pixels
_FREE = "free"
_OPENINGS = 4.0  # the slider's end, in openings to start with


def serve(subjects: Sequence[Subject], host: str, port: int, width: int, keyframes: Path) -> viser.ViserServer:
    """Start the viewer; it runs in threads of its own until `stop`. width: of a picture at rest, pixels.

    Raises InputError without the package viser (extra `view`).
    """
    try:
        import viser
    except ImportError:
        raise InputError("view", "no package viser", 'pip install "dofbench[view]"') from None
    with redirect_stdout(io.StringIO()):  # it prints its own address, behind the gate too
        server = viser.ViserServer(host=host, port=port, label="dofbench", verbose=False)
    server.gui.main_panel.dock_right()
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.scene.set_up_direction(tuple(subjects[0].up))
    rendering = threading.Lock()  # kernels use all cores: one picture at a time
    sessions: dict[int, _Session] = {}

    @server.on_client_connect
    def _(client: viser.ClientHandle) -> None:
        sessions[client.client_id] = _Session(client, subjects, width, keyframes, rendering)

    @server.on_client_disconnect
    def _(client: viser.ClientHandle) -> None:
        if (session := sessions.pop(client.client_id, None)) is not None:
            session.close()

    return server


def next_width(width: int, seconds: float, full: int) -> int:
    """Width of the next picture while something moves, when one of `width` pixels took so long. full: at rest.

    Time grows with the pixels. Half the step is taken, so that one slow picture doesn't decide.
    """
    factor = float(np.clip(math.sqrt(_FRAME / max(seconds, 1e-6)), 0.5, 2.0)) ** 0.5
    return int(np.clip(round(width * factor), min(_LEAST, full), full))


class _Session:
    """One browser: its controls, and a thread that makes its pictures."""

    def __init__(
        self,
        client: viser.ClientHandle,
        subjects: Sequence[Subject],
        width: int,
        keyframes: Path,
        rendering: threading.Lock,
    ):
        self._client, self._subjects, self._width = client, subjects, width
        self._file, self._rendering = keyframes, rendering
        self._keyframes: list[tuple[Camera, Look]] = []
        self._changed, self._over = threading.Event(), threading.Event()
        self._draft_width = width // 2
        self._last: Shown | None = None
        self._controls()
        self._show_cameras()
        self._go_to(subjects[0].photographs[0])
        client.camera.on_update(lambda _: self._changed.set())
        client.scene.on_click()(self._focus_at)
        self._changed.set()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """The browser has left."""
        self._over.set()
        self._changed.set()

    # ---- controls ----

    def _controls(self) -> None:
        gui, subject = self._client.gui, self._subjects[0]
        with gui.add_folder("Lens"):
            step = round(subject.opening / 50, 12) or 1e-6
            self._opening = gui.add_slider(
                "aperture",
                min=0.0,
                max=_OPENINGS * subject.opening,
                step=step,
                initial_value=subject.opening,
                hint="Half the width of the lens's opening, scene units; 0 is all in focus",
            )
            self._f_number = None
            if subject.f_scale is not None:
                self._f_number = gui.add_number(
                    "f-number",
                    initial_value=round(subject.f_scale / subject.opening, 2),
                    min=0.1,
                    step=0.1,
                    hint="By the EXIF of the training images",
                )
                self._f_number.on_update(lambda event: self._set_f_number(event))
            self._focus = gui.add_slider(
                "focus",
                min=-0.2,
                max=1.3,
                step=0.005,
                initial_value=0.5,
                hint="Normalised disparity: 0 far, 1 near. Or click a point of the picture",
            )
            self._blades = gui.add_slider("blades", min=0, max=9, step=1, initial_value=0, hint="0 for a disc")
            self._rotation = gui.add_slider("rotation", min=0, max=120, step=5, initial_value=0, hint="degrees")
            self._exposure = gui.add_slider("exposure", min=-3.0, max=3.0, step=0.1, initial_value=0.0, hint="stops")
        with gui.add_folder("Picture"):
            self._layer = gui.add_dropdown("show", options=self._layers(), initial_value=self._layers()[0])
            names = (_FREE, *(photograph.name for photograph in subject.photographs))
            self._view = gui.add_dropdown("at", options=names, initial_value=subject.photographs[0].name)
            self._wipe = gui.add_slider("wipe", min=0.0, max=1.0, step=0.01, initial_value=0.0)
            self._left = gui.add_dropdown(
                "left of it", options=self._layers(), initial_value="photograph", hint="Left of the wipe"
            )
            self._cameras = gui.add_checkbox("cameras", initial_value=False)
        with gui.add_folder("Film", expand_by_default=False) as film:
            add, save = gui.add_button("add keyframe"), gui.add_button("save keyframes")
            self._saved = gui.add_markdown("")
        self._info = gui.add_markdown("")
        rendered = (self._opening, self._focus, self._blades, self._rotation, self._layer, self._wipe, self._left)
        for control in (*rendered, self._exposure):
            control.on_update(lambda _: self._changed.set())
        for part in (*rendered, film):
            part.visible = subject.render is not None  # a dataset has its photographs and points alone
        self._opening.on_update(self._show_f_number)
        self._view.on_update(lambda _: self._go_to_name(self._view.value))
        self._cameras.on_update(lambda _: self._toggle_cameras())
        add.on_click(lambda _: self._add_keyframe())
        save.on_click(lambda _: self._save_keyframes())

    def _layers(self) -> tuple[str, ...]:
        if self._subjects[0].render is None:
            return ("photograph",)
        return tuple(layer for layer in LAYERS if layer != "resolved" or self._subjects[0].circles is not None)

    def _set_f_number(self, event: Any) -> None:
        """What a person typed; not what the slider wrote there."""
        scale = self._subjects[0].f_scale
        if event.client is not None and scale is not None and self._f_number is not None:
            _set(self._opening, min(scale / max(self._f_number.value, 1e-3), _OPENINGS * self._subjects[0].opening))

    def _show_f_number(self, event: Any) -> None:
        scale = self._subjects[0].f_scale
        if event.client is not None and scale is not None and self._f_number is not None and self._opening.value > 0:
            _set(self._f_number, round(scale / self._opening.value, 2))

    def _focus_at(self, event: Any) -> None:
        shown = self._last
        disparity = None if shown is None else shown.disparity_at(*event.screen_pos)
        if disparity is not None:
            bounds = self._subjects[0].bounds
            _set(self._focus, float(np.clip(bounds.normalise(disparity), self._focus.min, self._focus.max)))

    # ---- cameras ----

    def _show_cameras(self) -> None:
        self._frustums = []
        photographs = self._subjects[0].photographs
        centres = np.stack([photograph.camera.centre for photograph in photographs])
        reach = (
            float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).mean()) or 1 / self._subjects[0].bounds.q_max
        )
        for photograph in photographs:
            camera = photograph.camera
            frustum = self._client.scene.add_camera_frustum(
                f"/cameras/{photograph.name}",
                fov=2 * math.atan(0.5 * camera.height / camera.fy),
                aspect=camera.width / camera.height,
                scale=0.15 * reach,
                color=(230, 120, 30) if photograph.split == "test" else (40, 120, 220),
                wxyz=_quaternion(camera),
                position=tuple(camera.centre),
                visible=False,
            )
            frustum.on_click(partial(self._chosen, photograph.name))
            self._frustums.append(frustum)
        points = self._subjects[0].points
        if points is not None:
            away = float(np.median(np.linalg.norm(points[0] - centres.mean(axis=0), axis=1)))
            size = _POINT * away
            self._client.scene.add_point_cloud("/points", points=points[0], colors=points[1], point_size=size)

    def _chosen(self, name: str, _: object) -> None:
        self._go_to_name(name)

    def _toggle_cameras(self) -> None:
        for frustum in self._frustums:
            frustum.visible = self._cameras.value

    def _go_to_name(self, name: str) -> None:
        if name != _FREE:
            _set(self._view, name)
            self._go_to(next(one for one in self._subjects[0].photographs if one.name == name))

    def _go_to(self, photograph: Photograph) -> None:
        own, camera = self._client.camera, photograph.camera
        wide, tall = max(own.image_width, 1), max(own.image_height, 1)
        # Orbit about what is in the middle of the focus range.
        bounds = self._subjects[0].bounds
        away = 1 / (bounds.q_min + 0.5 * bounds.extent)
        with self._client.atomic():
            own.up_direction = tuple(-camera.camera_to_world[:3, 1])
            own.position = tuple(camera.centre)
            own.look_at = tuple(camera.centre + away * camera.camera_to_world[:3, 2])
            own.fov = fitting(camera, wide // len(self._subjects), tall)
        self._changed.set()

    def _camera(self, width: int) -> Camera:
        """The browser's camera, `width` pixels wide."""
        own = self._client.camera
        height = max(2, round(width / own.aspect))
        focal = 0.5 * height / math.tan(own.fov / 2)
        turn = _rotation(own.wxyz)
        pose = np.eye(4)
        pose[:3, :3] = turn.T
        pose[:3, 3] = -turn.T @ np.asarray(own.position)
        return Camera(width, height, focal, focal, width / 2, height / 2, pose)

    def _look(self) -> Look:
        bounds = self._subjects[0].bounds
        blades = int(self._blades.value)
        return Look(
            layer=self._layer.value,  # type: ignore[arg-type]
            half_opening=float(self._opening.value),
            focus_disparity=bounds.q_min + self._focus.value * bounds.extent,
            shape=ApertureShape(blades if blades >= 3 else 0, math.radians(self._rotation.value)),
            exposure=float(self._exposure.value),
            wipe=float(self._wipe.value),
            left=self._left.value,  # type: ignore[arg-type]
        )

    # ---- keyframes ----

    def _add_keyframe(self) -> None:
        self._keyframes.append((self._camera(1000), self._look()))
        self._saved.content = f"{len(self._keyframes)} keyframes"

    def _save_keyframes(self) -> None:
        if not self._keyframes:
            self._saved.content = "add keyframes first"
            return
        last = max(len(self._keyframes) - 1, 1)
        frames = [
            Keyframe.of(index / last, camera, look.focus_disparity, look.half_opening)
            for index, (camera, look) in enumerate(self._keyframes)
        ]
        write_keyframes(self._file, frames)
        self._saved.content = f"`dofbench render RESULT --keyframes {self._file}`"

    # ---- pictures ----

    def _work(self) -> None:
        at_rest, versions = False, self._versions()
        while not self._over.is_set():
            changed = self._changed.wait(timeout=_LOOK if at_rest else _REST)
            if self._over.is_set():
                return
            before, versions = versions, self._versions()
            if at_rest and not changed and versions == before:
                continue
            self._changed.clear()
            try:
                self._show(draft=changed)
            except Exception as error:  # a picture that failed is told, and the next one is tried
                self._info.content = f"{type(error).__name__}: {error}"
            at_rest = not changed

    def _versions(self) -> list[int]:
        return [subject.version() for subject in self._subjects]

    def _show(self, *, draft: bool) -> None:
        own = self._client.camera
        if own.update_timestamp == 0 or own.image_width == 0:
            return
        full = min(self._width, own.image_width)
        width = min(self._draft_width, full) if draft else full
        camera, look = self._camera(width - width % len(self._subjects)), self._look()
        begun = time.perf_counter()
        with self._rendering:
            shown = picture(self._subjects, camera, look, draft=draft)
        seconds = time.perf_counter() - begun
        if draft:
            self._draft_width = next_width(width, seconds, full)
        elif self._view.value != _FREE and at_photograph(self._subjects[0], camera) is None:
            _set(self._view, _FREE)  # so that the same view can be chosen again
        self._last = shown
        self._client.scene.set_background_image(shown.pixels, format="jpeg", jpeg_quality=70 if draft else 92)
        self._tell(camera, look, seconds, draft)

    def _tell(self, camera: Camera, look: Look, seconds: float, draft: bool) -> None:
        depth = f"{1 / look.focus_disparity:.3g}" if look.focus_disparity > 0 else "infinity"
        focus = "" if self._subjects[0].render is None else f"focus at {depth} scene units  \n"
        names = " · ".join(subject.name for subject in self._subjects)
        state = "moving" if draft else "at rest"
        steps = [f"step {version}" for version in self._versions() if version]
        self._info.content = (
            f"**{' · '.join([names, *steps])}**  \n{focus}"
            f"{camera.width} × {camera.height} px, {1000 * seconds:.0f} ms ({state})"
        )


def _set(control: Any, value: object) -> None:
    """Set a control's value: mypy takes viser's property, whose getter and setter have two types, for read-only."""
    control.value = value


def _quaternion(camera: Camera) -> tuple[float, float, float, float]:
    """(w, x, y, z) of camera to world."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(camera.camera_to_world[:3, :3]).as_quat()
    return float(w), float(x), float(y), float(z)


def _rotation(wxyz: np.ndarray) -> np.ndarray:
    """(3, 3) of a quaternion (w, x, y, z)."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = wxyz
    return np.asarray(Rotation.from_quat((x, y, z, w)).as_matrix())
