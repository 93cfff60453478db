// Flat sheet 80 x 40 mm in the plane z = 0 with a round hole of radius 6 about (46, 22): triangles, whose thickness the scene states. Physical
// curves: "left" and "right", and lower and upper edge in three parts each, "low_1" ... "up_3", from low to high x. Lengths in mm, h is the element size.
SetFactory("OpenCASCADE");
DefineConstant[ h = {5, Name "element size in mm"} ];
eps = 1e-3;
Rectangle(1) = {0, 0, 0, 80, 40};
Disk(2) = {46, 22, 0, 6};
BooleanDifference{ Surface{1}; Delete; }{ Surface{2}; Delete; }
For i In {1:2}
  x = i * 80 / 3;
  p = newp; Point(p) = {x, 0, 0};
  q = newp; Point(q) = {x, 40, 0};
  BooleanFragments{ Surface{:}; Delete; }{ Point{p, q}; Delete; }
EndFor
Physical Surface("sheet") = Surface{:};
Physical Curve("left") = Curve In BoundingBox{-eps, -eps, -eps, eps, 40+eps, eps};
Physical Curve("right") = Curve In BoundingBox{80-eps, -eps, -eps, 80+eps, 40+eps, eps};
For i In {1:3}
  a = (i - 1) * 80 / 3; b = i * 80 / 3;
  Physical Curve(Sprintf("low_%g", i)) = Curve In BoundingBox{a-eps, -eps, -eps, b+eps, eps, eps};
  Physical Curve(Sprintf("up_%g", i)) = Curve In BoundingBox{a-eps, 40-eps, -eps, b+eps, 40+eps, eps};
EndFor
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
