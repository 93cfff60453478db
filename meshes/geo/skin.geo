// A patch of skin, 100 x 50 mm and T thick, with two pads of 8 x 8 mm glued onto it, their middles at (XA, 20) and (XB, 20). Lengths in mm, h is the
// element size in the plane; x along the pull, y across, z out of the skin, which lies below z = 0.
SetFactory("OpenCASCADE");
DefineConstant[
  h = {5, Name "element size in mm"},
  T = {1.5, Name "thickness in mm"},
  XA = {30, Name "middle of the moving pad in mm"},
  XB = {70, Name "middle of the fixed pad in mm"}
];
eps = 1e-3;
Rectangle(1) = {0, -5, -T, 100, 50};
Rectangle(2) = {XA-4, 16, -T, 8, 8};
Rectangle(3) = {XB-4, 16, -T, 8, 8};
BooleanFragments{ Surface{1}; Delete; }{ Surface{2,3}; Delete; }
Extrude {0, 0, T} { Surface{:}; Layers{1}; }
Physical Volume("body") = Volume{:};
Physical Surface("moving") = Surface In BoundingBox{XA-4-eps, 16-eps, -eps, XA+4+eps, 24+eps, eps};
Physical Surface("fixed") = Surface In BoundingBox{XB-4-eps, 16-eps, -eps, XB+4+eps, 24+eps, eps};
Physical Surface("under") = Surface In BoundingBox{-eps, -5-eps, -T-eps, 100+eps, 45+eps, -T+eps};
Physical Surface("rim") = {
  Surface In BoundingBox{-eps, -5-eps, -T-eps, eps, 45+eps, eps},
  Surface In BoundingBox{100-eps, -5-eps, -T-eps, 100+eps, 45+eps, eps},
  Surface In BoundingBox{-eps, -5-eps, -T-eps, 100+eps, -5+eps, eps},
  Surface In BoundingBox{-eps, 45-eps, -T-eps, 100+eps, 45+eps, eps}
};
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
