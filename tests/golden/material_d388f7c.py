import bpy

target = bpy.context.object.dynamorph.active_target

target.stiffness = 20000.0
target.poisson = 0.4000000059604645
target.density = 1000.0
target.mass_damping = 1.0
target.stiffness_damping = 0.004999999888241291
