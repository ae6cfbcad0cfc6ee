# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact sheets: the same frames of several variants side by side, rendered without a display, in one PNG."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from PIL import Image, ImageDraw, ImageFont

MARGIN = 14
PAPER, INK, FAINT = (246, 246, 244), (30, 32, 36), (110, 114, 122)


@dataclass(frozen=True)
class Row:
    """One variant: its name, a line about it, a picture for each frame and a note under each picture."""

    name: str
    about: str
    pictures: Sequence[Image.Image]
    notes: Sequence[str]


def render(
    frames: Sequence[int],
    size: tuple[int, int],
    engine: str = "CYCLES",
    samples: int = 8,
    focus: Mapping[int, Sequence[float]] | None = None,
    zoom: float = 1.0,
) -> list[Image.Image]:
    """The open scene at `frames`, through its own camera and lights. CYCLES runs on the CPU, BLENDER_WORKBENCH needs
    EGL; EEVEE takes minutes a frame without a GPU. zoom: the part of the picture's width that is rendered, around the
    point `focus` has for the frame, world space."""
    scene = bpy.context.scene
    scene.render.engine = engine
    scene.render.resolution_x, scene.render.resolution_y = (round(pixels / zoom) for pixels in size)
    scene.render.resolution_percentage = 100
    scene.render.use_border = scene.render.use_crop_to_border = zoom < 1
    scene.render.use_persistent_data = True
    scene.render.image_settings.file_format = "PNG"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_denoising = True
    scene.cycles.max_bounces = 4
    pictures = []
    with tempfile.TemporaryDirectory() as folder:
        for frame in frames:
            scene.frame_set(frame)
            if zoom < 1:
                frame_point(focus[frame], zoom)
            scene.render.filepath = str(Path(folder, "frame.png"))
            with quiet():
                bpy.ops.render.render(write_still=True)
            with Image.open(scene.render.filepath) as picture:
                pictures.append(picture.convert("RGB").resize(size))  # a border may miss the size by a pixel
    return pictures


def frame_point(point: Sequence[float], zoom: float) -> None:
    """Render only the part `zoom` of the camera's picture, with a point of the world in its middle if it can be."""
    scene = bpy.context.scene
    x, y, _ = world_to_camera_view(scene, scene.camera, Vector(point))
    left, low = (min(max(middle - zoom / 2, 0), 1 - zoom) for middle in (x, y))
    scene.render.border_min_x, scene.render.border_max_x = left, left + zoom
    scene.render.border_min_y, scene.render.border_max_y = low, low + zoom


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Drop what Blender prints from C: a line for every step of every render, and EGL's harmless complaints."""
    saved = [os.dup(stream) for stream in (1, 2)]
    with Path(os.devnull).open("w") as nothing:
        for stream in (1, 2):
            os.dup2(nothing.fileno(), stream)
    try:
        yield
    finally:
        for stream, copy in zip((1, 2), saved, strict=True):
            os.dup2(copy, stream)
            os.close(copy)


@contextlib.contextmanager
def only_python() -> Iterator[None]:
    """Drop what Blender prints from C, and keep what Python does. Of an animated force field, as the bulging cylinder
    has one, Blender says in ten lines again and again that it is no rigid body."""
    outputs = sys.stdout, sys.stderr
    with os.fdopen(os.dup(1), "w", buffering=1) as out, os.fdopen(os.dup(2), "w", buffering=1) as errors, quiet():
        sys.stdout, sys.stderr = out, errors
        try:
            yield
        finally:
            sys.stdout, sys.stderr = outputs


def caption(picture: Image.Image, text: str) -> None:
    """Write on a picture, below on the left."""
    place = (10, picture.height - 32)
    ImageDraw.Draw(picture).text(place, text, "white", ImageFont.load_default(22), stroke_width=2, stroke_fill=INK)


def compose(title: str, subtitle: str, columns: Sequence[str], rows: Sequence[Row]) -> Image.Image:
    """One row for each variant; columns: what each one's pictures show."""
    font, small, large = (ImageFont.load_default(points) for points in (15, 12, 24))
    width, height = rows[0].pictures[0].size
    row_height = 26 + height + 22
    top = MARGIN + 66
    sheet = Image.new(
        "RGB", (2 * MARGIN + len(columns) * (width + 4) - 4, top + 24 + len(rows) * row_height + MARGIN), PAPER
    )
    draw = ImageDraw.Draw(sheet)
    draw.text((MARGIN, MARGIN), title, INK, large)
    draw.text((MARGIN, MARGIN + 36), subtitle, FAINT, font)
    for column, event in enumerate(columns):
        x = MARGIN + column * (width + 4)
        draw.text((x, top), event, INK, font)
        for r, row in enumerate(rows):
            y = top + 24 + r * row_height
            sheet.paste(row.pictures[column], (x, y + 26))
            draw.text((x, y + 26 + height + 3), row.notes[column], FAINT, small)
    for r, row in enumerate(rows):
        y = top + 24 + r * row_height + 4
        draw.text((MARGIN, y), row.name, INK, font)
        draw.text((MARGIN + draw.textlength(row.name, font) + 12, y + 2), row.about, FAINT, small)
    return sheet


def save(sheet: Image.Image, path: Path, small: bool = False) -> None:
    """Write a PNG; a small one for documents has 1200 pixels across and a dithered palette."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if small:
        sheet = sheet.resize((1200, round(1200 * sheet.height / sheet.width)), Image.Resampling.LANCZOS)
        palette = sheet.quantize(256, method=Image.Quantize.FASTOCTREE)  # median cut leaves the bands too few colors
        sheet = sheet.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)
    sheet.save(path, optimize=True)
