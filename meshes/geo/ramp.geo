// A body on a ramp: its bottom rises along x by `tilt` degrees, from z = 0 at x = 0; length and width along x and y, top at z = height.
// Physical surfaces "ramp", "foot" (x = 0) and "end" (x = length, from 10 mm above the ramp on). Lengths in mm, h is the element size.
SetFactory("OpenCASCADE");
DefineConstant[ h = {8, Name "element size in mm"}, tilt = {30, Name "angle of the ramp in degrees"},
  length = 48, width = 20, height = 50 ];
rise = length * Tan(tilt * Pi / 180);
Point(1) = {0, 0, 0};
Point(2) = {length, 0, rise};
Point(3) = {length, 0, rise + 10};
Point(4) = {length, 0, height};
Point(5) = {0, 0, height};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 1};
Curve Loop(1) = {1, 2, 3, 4, 5};
Plane Surface(1) = {1};
made[] = Extrude {0, width, 0} { Surface{1}; };
Physical Volume("body") = made[1];
Physical Surface("ramp") = made[2];
Physical Surface("end") = made[4];
Physical Surface("foot") = made[6];
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
