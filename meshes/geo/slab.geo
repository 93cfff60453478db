// The benchmark slab: 100 x 10 x 100 mm; x along the pull, y up (thickness), z across. Lengths in mm.
// Physical surfaces patch_1 ... patch_8 are the candidate anchors, grasp_I, grasp_II, grasp_III the 20 x 20 mm grasp areas.
// h is the element size. shift_z moves the grasp areas along the edge, shift_x on to the body (below 0) or off it, up to 15 mm either way;
// with either there is grasp_II alone, for shifted areas may lie on each other. A grasp area always reaches the edge face.
// Above 25 mm the grasp areas keep only their strip of the edge face, so that few elements suffice.
SetFactory("OpenCASCADE");
DefineConstant[
  h = {14, Name "element size in mm"},
  shift_x = {0, Name "shift of grasp II along x in mm"},
  shift_z = {0, Name "shift of grasp II along z in mm"}
];
eps = 1e-3;
coarse = h > 25;

Box(1) = {0, 0, 0, 100, 10, 100};
// Cuts: the middle of the edge faces z=100, x=0 and z=0, and the bottom quarters.
Rectangle(101) = {0, 0, 100, 50, 10};
Rectangle(102) = {0, 0, 0, 50, 10};
Rectangle(103) = {0, 0, 0, 50, 50};
Rotate {{1, 0, 0}, {0, 0, 0}, Pi/2} { Surface{103}; }
Rectangle(104) = {0, 0, 0, 50, 50};
Rotate {{1, 0, 0}, {0, 0, 0}, Pi/2} { Surface{104}; }
Translate {0, 0, 50} { Surface{104}; }
Rectangle(105) = {0, 0, 0, 50, 10};
Rotate {{0, 1, 0}, {0, 0, 0}, -Pi/2} { Surface{105}; }
tools() = {101, 102, 103, 104, 105};
centre() = {20, 50 + shift_z, 80};
moved = shift_x != 0 || shift_z != 0;
first = moved ? 1 : 0;
last = moved ? 1 : 2;
inner = 80 + shift_x;
For k In {first:last}
  edge = 110 + 10*k;
  Rectangle(edge) = {0, 0, 0, 20, 10};
  Rotate {{0, 1, 0}, {0, 0, 0}, -Pi/2} { Surface{edge}; }
  Translate {100, 0, centre(k) - 10} { Surface{edge}; }
  tools() += edge;
  If (!coarse)
    For side In {0:1}
      face = edge + 1 + side;
      Rectangle(face) = {inner, 0, 0, 100 - inner, 20};
      Rotate {{1, 0, 0}, {0, 0, 0}, Pi/2} { Surface{face}; }
      Translate {0, 10*side, centre(k) - 10} { Surface{face}; }
      tools() += face;
    EndFor
  EndIf
EndFor
BooleanFragments{ Volume{1}; Delete; }{ Surface{tools()}; Delete; }

Physical Volume("body") = {Volume{:}};
Physical Surface("patch_1") = Surface In BoundingBox{50-eps, -eps, 100-eps, 100+eps, 10+eps, 100+eps};
Physical Surface("patch_2") = Surface In BoundingBox{-eps, -eps, 100-eps, 50+eps, 10+eps, 100+eps};
Physical Surface("patch_3") = Surface In BoundingBox{-eps, -eps, 50-eps, eps, 10+eps, 100+eps};
Physical Surface("patch_4") = Surface In BoundingBox{-eps, -eps, -eps, eps, 10+eps, 50+eps};
Physical Surface("patch_5") = Surface In BoundingBox{-eps, -eps, -eps, 50+eps, 10+eps, eps};
Physical Surface("patch_6") = Surface In BoundingBox{50-eps, -eps, -eps, 100+eps, 10+eps, eps};
Physical Surface("patch_7") = Surface In BoundingBox{-eps, -eps, 50-eps, 50+eps, eps, 100+eps};
Physical Surface("patch_8") = Surface In BoundingBox{-eps, -eps, -eps, 50+eps, eps, 50+eps};
If (!moved)
  Physical Surface("grasp_I") = Surface In BoundingBox{80-eps, -eps, 10-eps, 100+eps, 10+eps, 30+eps};
  Physical Surface("grasp_III") = Surface In BoundingBox{80-eps, -eps, 70-eps, 100+eps, 10+eps, 90+eps};
EndIf
Physical Surface("grasp_II") = Surface In BoundingBox{inner-eps, -eps, 40+shift_z-eps, 100+eps, 10+eps, 60+shift_z+eps};

Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
If (coarse)
  Mesh.Algorithm = 3; // only the points of the geometry
Else
  Mesh.Algorithm = 6;
EndIf
Mesh.Optimize = 1;
