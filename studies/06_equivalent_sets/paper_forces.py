"""The paper's Tables 6 and 7, as printed: largest differences of ligament forces [N]."""

# By row; within it the ligaments; within these IG1, IG4.
PAPER_LIGAMENTS = ("ACL", "PCL", "MCL", "LCL")
PAPER_TABLE6 = {
    "0 deg": ((278, 238), (32, 20), (155, 242), (384, 400)),
    "30 deg": ((237, 183), (63, 40), (160, 244), (293, 262)),
    "60 deg": ((409, 350), (263, 201), (141, 228), (191, 166)),
}
PAPER_TABLE7 = {
    "anterior force": ((373, 322), (65, 40), (95, 176), (63, 55)),
    "posterior force": ((153, 142), (212, 241), (99, 182), (42, 29)),
    "varus moment": ((271, 247), (124, 165), (88, 161), (85, 93)),
    "valgus moment": ((126, 93), (151, 124), (127, 210), (91, 85)),
    "external moment": ((237, 183), (263, 201), (114, 193), (67, 70)),
    "internal moment": ((409, 350), (53, 88), (141, 228), (293, 262)),
}
