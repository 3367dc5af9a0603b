"""Every numerical tolerance of the suite, with the reason. Tests import from here; none writes its own."""

# float32 kernel against the float64 reference: relative to the largest magnitude of the compared array.
FLOAT32_VALUE = 2e-5
FLOAT32_GRADIENT = 2e-4
# float64 against float64, or against an exact identity.
FLOAT64_VALUE = 1e-10
# Central finite differences in float64 with a step of 1e-6 keep about half of the digits.
FINITE_DIFFERENCE = 1e-5
