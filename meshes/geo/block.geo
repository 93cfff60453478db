// A block from (x0, y0, z0) to (x1, y1, z1) with a ball of radius r about (cx, cy, cz) that the mesh is fitted to if r > 0: physical
// volumes "body" and "ball", surfaces "bottom" (z = z0) and "top" (z = z1). Lengths in mm, h is the element size.
SetFactory("OpenCASCADE");
DefineConstant[ h = {10, Name "element size in mm"},
  x0 = 0, y0 = 0, z0 = 0, x1 = 80, y1 = 60, z1 = 40, cx = 42, cy = 30, cz = 20, r = 0 ];
eps = 1e-3;
Box(1) = {x0, y0, z0, x1-x0, y1-y0, z1-z0};
If (r > 0)
  Sphere(2) = {cx, cy, cz, r};
  BooleanFragments{ Volume{1}; Delete; }{ Volume{2}; Delete; }
EndIf
Physical Volume("body") = Volume{:};
If (r > 0)
  Physical Volume("ball") = Volume In BoundingBox{cx-r-eps, cy-r-eps, cz-r-eps, cx+r+eps, cy+r+eps, cz+r+eps};
EndIf
Physical Surface("bottom") = Surface In BoundingBox{x0-eps, y0-eps, z0-eps, x1+eps, y1+eps, z0+eps};
Physical Surface("top") = Surface In BoundingBox{x0-eps, y0-eps, z1-eps, x1+eps, y1+eps, z1+eps};
If (r > 0)
  // Facets of the ball are smaller: they cut it off.
  Mesh.MeshSizeFromCurvature = 24;
EndIf
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h / 3;
Mesh.MeshSizeMax = h;
