// A flat finger that bends: 90 x 6 x 30 mm; x along it, y up (thickness), z across. Lengths in mm.
// Physical surfaces patch_1 ... patch_6 are the candidate anchors, all in the half near x = 0: 1 and 2 the halves of the end face, at
// small and at large z; 3 and 4 the sides beside it; 5 and 6 the borders of the bottom further on. grasp_tip is the last 10 mm, and
// grasp_middle a band 10 mm wide across top and bottom. h is the element size.
SetFactory("OpenCASCADE");
DefineConstant[ h = {8, Name "element size in mm"} ];
eps = 1e-3;
length = 90;
height = 6;
width = 30;

Box(1) = {0, 0, 0, length, height, width};
// Cuts of the bottom and the top, as rectangles x0, x1, z0, z1 at a height y.
x0() = {30, 30, 58, 58, 80, 80};
x1() = {46, 46, 68, 68, 90, 90};
z0() = {0, 20, 0, 0, 0, 0};
z1() = {10, 30, width, width, width, width};
y0() = {0, 0, 0, height, 0, height};
tools() = {};
For k In {0:#x0()-1}
  Rectangle(100+k) = {x0(k), 0, 0, x1(k)-x0(k), z1(k)-z0(k)};
  Rotate {{1, 0, 0}, {0, 0, 0}, Pi/2} { Surface{100+k}; }
  Translate {0, y0(k), z0(k)} { Surface{100+k}; }
  tools() += 100+k;
EndFor
// Cuts of the sides, and of the end face.
For k In {0:1}
  Rectangle(120+k) = {8, 0, k*width, 20, height};
  Rectangle(130+k) = {80, 0, k*width, 10, height};
  tools() += {120+k, 130+k};
EndFor
Rectangle(140) = {0, 0, 0, width/2, height};
Rotate {{0, 1, 0}, {0, 0, 0}, -Pi/2} { Surface{140}; }
tools() += 140;
BooleanFragments{ Volume{1}; Delete; }{ Surface{tools()}; Delete; }

Physical Volume("body") = {Volume{:}};
Physical Surface("patch_1") = Surface In BoundingBox{-eps, -eps, -eps, eps, height+eps, width/2+eps};
Physical Surface("patch_2") = Surface In BoundingBox{-eps, -eps, width/2-eps, eps, height+eps, width+eps};
Physical Surface("patch_3") = Surface In BoundingBox{8-eps, -eps, -eps, 28+eps, height+eps, eps};
Physical Surface("patch_4") = Surface In BoundingBox{8-eps, -eps, width-eps, 28+eps, height+eps, width+eps};
Physical Surface("patch_5") = Surface In BoundingBox{30-eps, -eps, -eps, 46+eps, eps, 10+eps};
Physical Surface("patch_6") = Surface In BoundingBox{30-eps, -eps, 20-eps, 46+eps, eps, width+eps};
below() = Surface In BoundingBox{58-eps, -eps, -eps, 68+eps, eps, width+eps};
above() = Surface In BoundingBox{58-eps, height-eps, -eps, 68+eps, height+eps, width+eps};
Physical Surface("grasp_middle") = {below(), above()};
Physical Surface("grasp_tip") = Surface In BoundingBox{80-eps, -eps, -eps, length+eps, height+eps, width+eps};

Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
Mesh.Algorithm = 6;
Mesh.Optimize = 1;
