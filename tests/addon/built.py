# SPDX-License-Identifier: GPL-3.0-or-later
"""A model that is built once, for all the tests of a module."""

from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene import plain
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from bl_ext.user_default.dynamic_morph_targets.write import assign, storage


class BuiltOnce:
    """model: what the first object got; the objects after it must be like that one."""

    model = None

    def give(self, obj, modes):
        """The object has the model, as if it had just been built with so many modes."""
        record = obj.dynamorph.model
        if self.model is None:
            batch.run(Job(obj, goal="BUILD"))
            self.model, self._record = model_store.stored_model(obj), plain.plain(record)
        storage.keep_model(obj, self.model)
        assign.assign(record, self._record)
        record.stale = ""
        storage.fit_modes(obj, modes)


class SmallModel(BuiltOnce):
    """A model for tests of what is done with one: it is built in 0.2 s, and has 65 kB."""

    def give(self, obj, modes=4):
        settings = obj.dynamorph.model
        settings.modes, settings.cage_nodes = modes, 100
        super().give(obj, modes)
