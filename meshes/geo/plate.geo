// Quarter-hole plate 100 x 100 x 10 mm, hole of radius 30 about (100, 100). Lengths in mm, h is the element size in the plane.
SetFactory("OpenCASCADE");
DefineConstant[ h = {10, Name "element size in mm"} ];
eps = 1e-3;
Rectangle(1) = {0, 0, 0, 100, 100};
Disk(2) = {100, 100, 0, 30};
f() = BooleanDifference{ Surface{1}; Delete; }{ Surface{2}; Delete; };
o() = Extrude {0, 0, 10} { Surface{f()}; Layers{1}; };
Physical Volume("body") = Volume{:};
Physical Surface("x") = Surface In BoundingBox{100-eps,-eps,-eps,100+eps,100+eps,10+eps};
Physical Surface("y") = Surface In BoundingBox{-eps,100-eps,-eps,100+eps,100+eps,10+eps};
Physical Surface("faces") = {Surface In BoundingBox{-eps,-eps,-eps,100+eps,100+eps,eps}, Surface In BoundingBox{-eps,-eps,10-eps,100+eps,100+eps,10+eps}};
Physical Surface("edges") = {Surface In BoundingBox{-eps,-eps,-eps,eps,100+eps,10+eps}, Surface In BoundingBox{-eps,-eps,-eps,100+eps,eps,10+eps}};
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
