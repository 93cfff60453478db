// A gallbladder-like body, about 78 mm long: a pear (fundus at x = 0) that tapers into a bent neck; flattened and drooping, so that it
// has no symmetry. y is up: the liver lies below, the visible side is above. Lengths in mm.
// Physical surfaces patch_1 ... patch_6 are the candidate anchors on the liver side, two rows of three from the fundus to the neck
// (1, 2, 3 at z > 0 and 4, 5, 6 at z < 0); grasp_neck is the end of the neck, where it is grasped. h is the element size.
SetFactory("OpenCASCADE");
DefineConstant[ h = {10, Name "element size in mm"} ];

// Outline of the pear: distance from the axis and slope at each x; a vertical tangent at the fundus, a horizontal one at the neck.
x() = {0, 9, 24, 39, 52, 59};
r() = {0, 12.2, 15.8, 13.2, 8.6, 7.2};
slope() = {0, 0.62, 0.02, -0.36, -0.3, 0};
bend = 55*Pi/180; // of the neck
radius = 14;      // of its centre line
end = 9;          // straight part that is grasped
half = 62*Pi/180; // the patches reach this far to both sides of the lowest line

For i In {0:5}
  Point(i+1) = {x(i), -r(i), 0};
EndFor
Point(11) = {0, -8.2, 0};
Point(12) = {x(1) - 4.6, -(r(1) - 4.6*slope(1)), 0};
Bezier(1) = {1, 11, 12, 2};
For i In {1:4}
  third = (x(i+1) - x(i))/3;
  Point(20+2*i) = {x(i) + third, -(r(i) + third*slope(i)), 0};
  Point(21+2*i) = {x(i+1) - third, -(r(i+1) - third*slope(i+1)), 0};
  Bezier(1+i) = {i+1, 20+2*i, 21+2*i, i+2};
EndFor

// Turn the outline about the x axis in three parts: the row of patches at z > 0, the one at z < 0, and the rest.
For i In {1:5}
  part() = Extrude {{1, 0, 0}, {0, 0, 0}, -half} { Curve{i}; };
  near(i-1) = part(1);
  part() = Extrude {{1, 0, 0}, {0, 0, 0}, half} { Curve{i}; };
  far(i-1) = part(1);
  rest() = Extrude {{1, 0, 0}, {0, 0, 0}, 2*Pi - 2*half} { Curve{part(0)}; };
  above(i-1) = rest(1);
EndFor

// The neck: a circle turned about an axis across it, then drawn out, and closed.
Circle(200) = {0, 0, 0, r(5), 0, 2*Pi};
Rotate {{0, 1, 0}, {0, 0, 0}, Pi/2} { Curve{200}; }
Translate {x(5), 0, 0} { Curve{200}; }
up = 0.8;
side = 0.6;
turned() = Extrude {{0, -side, up}, {x(5), radius*up, radius*side}, bend} { Curve{200}; };
drawn() = Extrude {end*Cos(bend), end*Sin(bend)*up, end*Sin(bend)*side} { Curve{turned(0)}; };
Curve Loop(900) = {drawn(0)};
Plane Surface(900) = {900};

BooleanFragments{ Surface{near(), far(), above(), turned(1), drawn(1), 900}; Delete; }{ }
Surface Loop(901) = {near(), far(), above(), turned(1), drawn(1), 900};
Volume(901) = {901};

// Flatten it along an oblique direction.
Rotate {{0, 0, 1}, {25, 0, 0}, 14*Pi/180} { Volume{901}; }
Rotate {{1, 0, 0}, {0, 0, 0}, 20*Pi/180} { Volume{901}; }
Dilate {{25, 0, 0}, {1.02, 0.84, 1.1}} { Volume{901}; }
Rotate {{1, 0, 0}, {0, 0, 0}, -20*Pi/180} { Volume{901}; }
Rotate {{0, 0, 1}, {25, 0, 0}, -8*Pi/180} { Volume{901}; }
// The flattened body has surfaces of its own, in the order of the surface loop; the first ones are not needed any more.
skin() = Abs(Boundary{ Volume{901}; });
Recursive Delete { Surface{near(), far(), above(), turned(1), drawn(1), 900}; }

Physical Volume("body") = {901};
For i In {1:3}
  Physical Surface(Sprintf("patch_%g", i)) = {skin(i)};
  Physical Surface(Sprintf("patch_%g", i+3)) = {skin(i+5)};
EndFor
Physical Surface("grasp_neck") = {skin(16), skin(17)};

Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeMax = h;
Mesh.Algorithm = 6;
If (h > 20)
  Mesh.MeshSizeMin = h;
  Mesh.MinimumCurveNodes = 2; // only the points of the geometry
Else
  Mesh.MeshSizeFromCurvature = 6;
  Mesh.MeshSizeMin = 0.3*h;
EndIf
Mesh.Optimize = 1;
