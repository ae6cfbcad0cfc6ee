# SPDX-License-Identifier: GPL-3.0-or-later
"""The build of a new soft skin, which moves in Live before all of its modes are found."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import bpy
import numpy as np

from ...core import engine, logger
from ...core.character import Character
from ...core.errors import SceneError, WriteError
from ...core.model.model import Model
from ...scene import events
from ...scene.remembered import opened
from .. import live, remembered
from ..bake.bake_result import store_materials
from ..bake.batch import Batch
from ..bake.job import Job
from . import preview


class FirstLook(Batch):
    """Builds the model of a new soft skin. Live shows a draft of it while the rest is built, and goes on with the
    whole.

    The draft is never stored: where the build ends without a model, Live is off again. shows: whether the draft was
    shown, or cannot be.
    """

    def __init__(self, obj: bpy.types.Object):
        super().__init__([Job(obj, "BUILD", rebuild=True, drafts=True)], "BUILD")
        self.shows = False

    def steps(self, seconds: float = np.inf) -> Iterator[None]:
        for _ in super().steps(seconds):
            draft = self.jobs[0].draft
            if draft and not self.shows and not events.render_runs():
                self.shows = True
                self._show(draft)
            yield
        self._withdraw()

    def write(self) -> Iterator[None]:
        """When the hop has ended: an undo step would store the rig as that shakes it."""
        while self._preview and self._preview.moves_rig:
            self.jobs[0].progress.message = "Waiting for the test to end"
            yield from self._turn()
        yield from super().write()

    @property
    def _preview(self) -> preview.Preview | None:
        """The one of this soft skin that runs."""
        running, target = remembered.live.preview, self.jobs[0].request.target
        return running if running and running.object.session_uid == target.session_uid else None

    def _show(self, draft: tuple[Model, Character]) -> None:
        """Turn Live on. What prevents that is said when the model is there."""
        request = self.jobs[0].request
        if request.scene.find() != bpy.context.scene:  # the artist has gone on in another one
            return
        try:
            obj = request.target.find()
            store_materials(obj, draft[1])
            opened.drafts[obj.session_uid] = draft
            live.turn_on(obj, bpy.context.scene)
        except engine.expected_errors():
            pass
        except Exception as bug:
            logger.log_bug(bug)

    def stop(self) -> None:
        super().stop()
        self._withdraw()

    def _withdraw(self) -> None:
        """Nothing plays the draft any more."""
        if not opened.drafts.pop(self.jobs[0].request.target.session_uid, None):
            return
        with suppress(SceneError, WriteError):  # it was deleted; or is edited now, and Live says what is missing
            obj = self.jobs[0].request.target.find()
            if obj.dynamorph.model.content_id:
                live.refresh(obj)
                return
            if self._preview:
                preview.end_preview()
            if obj.dynamorph.live.key.name and not events.render_runs():
                live.turn_off(obj)
