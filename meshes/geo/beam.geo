// A silicone beam of 100 x 30 x 30 mm: x along it (the clamp at x = -100, the free end at x = 0), z up. Lengths in mm.
// Physical surfaces clamp (x = -100), tip (x = 0), top (z = 30), bottom (z = 0), left (y = 30), right (y = 0); the physical curve
// tip_edge (x = 0, z = 30) is where a weight hangs. h is the element size.
SetFactory("OpenCASCADE");
DefineConstant[ h = {10, Name "element size in mm"} ];
eps = 1e-3;

Box(1) = {-100, 0, 0, 100, 30, 30};

Physical Volume("body") = {1};
Physical Surface("clamp") = Surface In BoundingBox{-100-eps, -eps, -eps, -100+eps, 30+eps, 30+eps};
Physical Surface("tip") = Surface In BoundingBox{-eps, -eps, -eps, eps, 30+eps, 30+eps};
Physical Surface("top") = Surface In BoundingBox{-100-eps, -eps, 30-eps, eps, 30+eps, 30+eps};
Physical Surface("bottom") = Surface In BoundingBox{-100-eps, -eps, -eps, eps, 30+eps, eps};
Physical Surface("left") = Surface In BoundingBox{-100-eps, 30-eps, -eps, eps, 30+eps, 30+eps};
Physical Surface("right") = Surface In BoundingBox{-100-eps, -eps, -eps, eps, eps, 30+eps};
Physical Curve("tip_edge") = Curve In BoundingBox{-eps, -eps, 30-eps, eps, 30+eps, 30+eps};

Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
Mesh.Algorithm = 6;
Mesh.Optimize = 1;
