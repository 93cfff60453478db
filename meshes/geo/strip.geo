// A rubber strip of 70 x 4.45 x 1 mm: x along it, y across, z normal to it; its gauge is 0 < x < 50. Lengths in mm.
// Physical surfaces fixed (x = -10), moved (x = 60). h is the element size.
SetFactory("OpenCASCADE");
DefineConstant[ h = {2.2, Name "element size in mm"} ];
eps = 1e-3;

Box(1) = {-10, -2.225, -0.5, 70, 4.45, 1};

Physical Volume("body") = {1};
Physical Surface("fixed") = Surface In BoundingBox{-10-eps, -2.225-eps, -0.5-eps, -10+eps, 2.225+eps, 0.5+eps};
Physical Surface("moved") = Surface In BoundingBox{60-eps, -2.225-eps, -0.5-eps, 60+eps, 2.225+eps, 0.5+eps};

Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
