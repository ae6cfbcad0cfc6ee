import bpy

skin = bpy.context.object.dynamorph

skin.model.method = "DYNAMIC"
skin.model.law = "STABLE_STVK"
skin.model.solver = "REDUCED"
skin.model.blending = "EVEN"
skin.model.modes = 8
skin.model.fit_to_shot = False
skin.model.cage_nodes = 200
skin.model.cage_thickness = 0.0
skin.model.cage_grading = 0.0
skin.model.pin_radius = 0.4000000059604645
skin.model.separate = True
skin.simulation.substeps = 0
skin.simulation.samples = 1
skin.simulation.scheme = "BDF2"
skin.simulation.gravity = 1.0
skin.simulation.fields = 1.0
skin.simulation.begin = "SETTLE"
skin.simulation.preroll = 0
skin.simulation.preroll_pose = "HELD"
skin.simulation.keep_outside = False
skin.simulation.loop = False
