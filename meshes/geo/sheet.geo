// Sheet 80 x 40 x 4 mm with an inlay, an ellipse about (32, 24) turned by 30 deg: physical volumes "body" and "inlay". Lengths in mm, h is the
// element size in the plane. With fitted = 0 the mesh does not know of the inlay.
SetFactory("OpenCASCADE");
DefineConstant[ h = {5, Name "element size in mm"}, fitted = {0, Choices{0, 1}, Name "mesh fitted to the inlay"} ];
eps = 1e-3;
Rectangle(1) = {0, 0, 0, 80, 40};
If (fitted)
  Disk(2) = {32, 24, 0, 12, 8};
  Rotate {{0, 0, 1}, {32, 24, 0}, Pi/6} { Surface{2}; }
  BooleanFragments{ Surface{1}; Delete; }{ Surface{2}; Delete; }
EndIf
Extrude {0, 0, 4} { Surface{:}; Layers{1}; }
Physical Volume("body") = Volume{:};
If (fitted)
  Physical Volume("inlay") = Volume In BoundingBox{32-13, 24-13, -eps, 32+13, 24+13, 4+eps};
EndIf
Physical Surface("clamp") = Surface In BoundingBox{-eps, -eps, -eps, eps, 40+eps, 4+eps};
Physical Surface("jaw") = Surface In BoundingBox{80-eps, -eps, -eps, 80+eps, 40+eps, 4+eps};
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
