// The gauge of a tensile specimen (ASTM D412, die C, as its grips hold it): 33 x 6 x 3 mm, x along the pull. Lengths in mm.
// Physical surfaces start (x = 0), end (x = 33), bottom (y = 0), back (z = 0). h is the element size.
SetFactory("OpenCASCADE");
DefineConstant[ h = {6, Name "element size in mm"} ];
eps = 1e-3;

Box(1) = {0, 0, 0, 33, 6, 3};

Physical Volume("body") = {1};
Physical Surface("start") = Surface In BoundingBox{-eps, -eps, -eps, eps, 6+eps, 3+eps};
Physical Surface("end") = Surface In BoundingBox{33-eps, -eps, -eps, 33+eps, 6+eps, 3+eps};
Physical Surface("bottom") = Surface In BoundingBox{-eps, -eps, -eps, 33+eps, eps, 3+eps};
Physical Surface("back") = Surface In BoundingBox{-eps, -eps, -eps, 33+eps, 6+eps, eps};

Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
