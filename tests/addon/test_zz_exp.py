import time, resource, numpy as np, bpy, pytest
from builders import *
from robustness import OPS, bake, coarse
from test_faults_mesh import *
@pytest.mark.parametrize("side", [300, 1000])
def test_m13(scene, side):
    t=time.time()
    rows, around = side, side
    turn=np.arange(around)*2*np.pi/around
    z=np.linspace(0,2,rows); radius=0.3*np.sqrt(np.clip(1-((z-1)/1.0001)**2,0,1))+1e-3
    v=np.stack(np.broadcast_arrays(radius[:,None]*np.cos(turn),radius[:,None]*np.sin(turn),z[:,None]),-1).reshape(-1,3)
    from test_defects import grid_triangles
    f=grid_triangles(rows,around)
    mesh=bpy.data.meshes.new("Big")
    mesh.vertices.add(len(v)); mesh.vertices.foreach_set("co", v.astype(np.float32).ravel())
    mesh.loops.add(f.size); mesh.loops.foreach_set("vertex_index", f.astype(np.int32).ravel())
    mesh.polygons.add(len(f)); mesh.polygons.foreach_set("loop_start", np.arange(0,f.size,3,dtype=np.int32))
    mesh.update(calc_edges=True)
    obj=bpy.data.objects.new("Big",mesh); scene.collection.objects.link(obj)
    rig=make_rig(scene,"Big Rig")
    for bone, m in (("upper", v[:,2]<=1),("lower",v[:,2]>1)):
        obj.vertex_groups.new(name=bone).add(np.flatnonzero(m).tolist(),1.0,"REPLACE")
    obj.modifiers.new("Armature","ARMATURE").object=rig
    for frame, angle in ((1, 0.0), (5, 0.5)):
        rig.pose.bones["lower"].rotation_euler.x = angle
        rig.pose.bones["lower"].keyframe_insert("rotation_euler", frame=frame)
    scene.frame_end=5; scene.frame_set(1); activate(obj)
    print("EXP made", len(f), time.time()-t, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss/1e6)
    OPS.add_soft_skin(); coarse(obj)
    obj.dynamorph.simulation.substeps=1
    print("EXP added", time.time()-t)
    job=bake(obj)
    print("EXP baked", time.time()-t, job.seconds, job.model.summary["seconds"], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss/1e6, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss/1e6)
