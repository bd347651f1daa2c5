"""What lenses people use, learned from published calibrations: benchmarks/lens_priors.py writes this file.

280 cameras of 126 repositories. Radial terms are in parts of the picture: k1 s^2, k2 s^4, k3 s^6 with
s the tangent at half the larger side, (side / 2) / focal.
"""

RADIAL = (
    (
        0.224,
        (-0.189, 0.0355, -0.00718),
        ((0.00264, -0.000612, 0.000125), (-0.000612, 0.000236, -4.26e-05), (0.000125, -4.26e-05, 2.33e-05)),
    ),
    (
        0.513,
        (-0.00488, -0.00178, -0.00172),
        ((0.00147, -0.000556, 0.000121), (-0.000556, 0.000306, -7.18e-05), (0.000121, -7.18e-05, 3.83e-05)),
    ),
    (
        0.158,
        (0.041, -0.0526, 0.0187),
        ((0.00066, -0.000708, 0.000401), (-0.000708, 0.00126, -0.000733), (0.000401, -0.000733, 0.000476)),
    ),
    (0.106, (-0.106, 0.00154, 0.0352), ((0.0292, 0, 0), (0, 0.00436, 0), (0, 0, 0.00244))),
)
"""Weight, mean and covariance of each class: barrel, nearly none, pincushion, any."""

RADIAL_FOCAL = (
    (-0.427, 0.215, (0.19, -0.0409, 0.00323)),
    (-0.0898, 0.338, (-0.00132, 0.00185, -0.00452)),
    (-0.193, 0.292, (-0.01, 0.0139, 0.00496)),
    (-0.549, 0.326, (0.212, -0.0785, -0.0157)),
)
"""FOCAL of each class, and how its radial terms change with that number: long lenses bend less."""

CENTRE = ((0.513, 0.00607), (0.487, 0.0264))
"""Weight and sigma, of each coordinate, of the larger side."""

TANGENTIAL = ((0.881, 0.00126), (0.119, 0.0108))
"""Weight and sigma of p1 and p2."""

ASPECT = ((0.63, 0.00205), (0.37, 0.00717))
"""Weight and sigma of the aspect about 1."""

FOCAL = (-0.23, 0.351)
"""Mean and sigma of log(focal / larger side)."""

FISHEYE = ((0.024, 0.0354, -0.0178, 0.0275), (0.0739, 0.0676, 0.0238, 0.0495))
"""Mean and sigma of k1 to k4 of the equidistant polynomial."""

FISHEYE_FOCAL = (-0.849, 0.28)
"""As FOCAL, of fisheyes."""
