"""Every numerical tolerance of the suite, with the reason. Tests import from here; none writes its own."""

# float32 kernel against the float64 reference: relative to the largest magnitude of the compared array. A sum of n
# terms, rounded n times by chance up or down, is off by more than 6 sqrt(n) 2^-24 once in 1e8 sums: 1.6e-5 for 2000.
# Beside that, the scatter leaves out tails below exp(-12) of a weight, 6e-6.
FLOAT32_VALUE = 2e-5
# The same for a sum of squared differences, whose relative error is twice as large.
FLOAT32_DISTORTION = 5e-5
FLOAT32_GRADIENT = 2e-4
# float64 against float64, or against an exact identity.
FLOAT64_VALUE = 1e-10
# Central finite differences in float64 with a step of 1e-6 keep about half of the digits.
FINITE_DIFFERENCE = 1e-5
# A rotation through a quaternion, a matrix product and back: a few roundings of float64, times scene units of order 10.
POSE_ROUND_TRIP = 1e-9
# A rotation with entries rounded to three digits is off by 3 * 0.0005 in the Frobenius norm, the nearest rotation by
# twice that at most.
ROUNDED_ROTATION = 3e-3
# Positions of up to 1e7 scene units and a rotation's products with them, in float64 with steps of 1.9e-9 there: some
# ten roundings on the way into a file and out of it.
FAR_POSITION = 3e-8
# A distortion inverted by Newton's method, in pixels: the method stops at 1e-12 of the focal length.
UNDISTORTED_PIXEL = 1e-6
# Waves of amplitude 0.4 resampled by OpenCV's Lanczos, worst along a diagonal with a period of 60 pixels, where both
# axes add up: by its closed form the kernel, at its worst offset, changes such a wave by 1.5e-3 of its amplitude, and
# OpenCV rounds offsets to 1/32 pixel. Half a pixel of misplacement would be 3e-2.
RESAMPLED = 0.4 * 2 * (1.5e-3 + 2 * 3.1416 / 60 / 64)
# One level of an 8-bit image.
LEVEL_8BIT = 1.0 / 255.0
# Colours converted by two colour managements, which round curves and matrices in their own ways, of which one gives
# 8 bits. A profile that isn't applied is off by more than ten levels.
CONVERTED_COLOUR = 1.0 / 255.0
# Smooth colours after HEVC's or AV1's best quality, whose YCbCr of 8 bits costs a level and a half.
COMPRESSED_COLOUR = 3.0 / 255.0
# Mean reprojection error of a structure from motion model before and after undistortion, but for the enlargement:
# distortion stretches it by its derivative.
REPROJECTION_STRETCH = 2e-2
# SSIM loss close to convergence: relative error of 1 - SSIM at about 1e-4, from float32 variances of [0, 1] pixels
# (1e-8) against the stabiliser 9e-4. The usual float32 formula, which subtracts from 1, is off by 1e-3 there.
SSIM_NEAR_ONE = 1e-4
# A float32 coordinate in an image of some hundred pixels, with the rounding of its way there.
TABLE_PIXEL = 1e-3
# The border of a barrel is no rectangle: what fits inside can miss the widest view by a fraction of a pixel.
GIVEN_AWAY = 0.1
# OpenCV traces the border of an undistorted image at nine points a side; we at every pixel.
OPENCV_ALPHA = 1e-2
# Two files hold one pose, through quaternions and through matrices: of 1e-15 relative each, times scene units of 100.
SAME_POSE = 1e-8
# CIELAB of sRGB's primaries to three decimals, relative.
PUBLISHED_COLOURS = 1e-4
# Each pixel of FLIP, 0 ... 1, against its authors' package, which computes in float32: a rounding of a feature counts
# by its square root.
FLIP_IN_FLOAT32 = 1e-4
# sRGB's matrix and white point are standardised to four digits; programs differ in the next.
DELTA_E_BY_FORMULA = 2e-3
# PSNR (dB) of 8-bit images against the float64 blur (docs/conventions.md, "A dataset folder"). Rounding alone leaves
# 58.9.
RECOMPUTED_PSNR = 55.0
# The built-in scene. Pixels between a view's picture and another's that its depth carries there: the least mistake of
# cameras or conventions is half a pixel, and this is half of it.
BUILT_IN_REGISTRATION_PX = 0.25
# The part of the pixels where a render may see another surface than the shipped depth has.
BUILT_IN_SILHOUETTE = 5e-3
# A render with few samples against the shipped image, dB; as the same scene with another shadow or texture wouldn't be.
BUILT_IN_RENDER_PSNR = 36.0
# Sums of scatter weights are published with two decimals (docs/published-methods.md, "Scatter").
SCATTER_ENERGY = 6e-3
# Gradient with respect to the radius where it is nearly zero (a single pixel, radii beyond the image): float32 noise of
# terms of order 1 that cancel, as a share of the incoming gradient.
SCATTER_DARK = 1e-2
# Every pixel around a highlight 1e6 times as bright, relative to itself.
HIGHLIGHT = 1e-4
# Light of a disc 16 pixels wide on stripes one pixel wide: which of them its rim cuts off is not exactly half.
HALF_LIT = 1e-2
# A plane's depth by an expression affine in the pixel: second order in the angle, up to 5 pixels of 1/400 at
# 50 degrees.
PLANE_DEPTH = 5e-4
# The light of a single Gaussian before and after blur: a sum over pixels with a rim, where alpha falls from 1/255 to 0.
# The rim of the faintest and smallest, opacity 0.1 and deviation 1.5 pixels, has a radius of 3.8 pixels and crosses 31
# pixels, each in any place: the sum varies by sqrt(31 / 12) / 255, of the light of 1.36. Four standard deviations, of
# two such sums, as the blurred one's rim is longer and fainter.
BLUR_INTEGRAL = 4 * (31 / 12) ** 0.5 / 255 / 1.36 * 2**0.5
# Gradient by the blur of needles 40 pixels long, a third of a pixel wide: second moments in float32 keep their digits
# along the needle and lose the square of that ratio across it.
BLUR_OF_NEEDLES = 2e-3
# Distortion of a layer of 1e-3 at depth 5, relative: a ray length of 5 is rounded by up to 2.4e-7.
DISTORTION = 2e-3
# A blended normal against the released code's formula, in float64; they are one vector.
PUBLISHED_NORMAL = 1e-9
# A tilted plane of small discs, relative: each one's ray length is affine in the pixel, and it is seen up to 0.07
# radians from its centre, which to second order is 2.4e-3.
SURFACE_OF_DISCS = 3e-3
# The same float32 sums with pixel coordinates counted from another corner.
TILING = 5e-5
# exp2_fast8: a polynomial of degree 5. exp8 and log2_8: two roundings of float32.
EXP2_FAST = 2.5e-7
EIGHT_LANES = 1.5e-7
# Normals of an exact plane by float64 differences.
PLANE_NORMAL = 1e-12
# A handful of float32 operations on numbers of order 1, relative.
FLOAT32_SCALAR = 1e-6
# How near Adam with a falling learning rate comes to the true lens.
LENS_FOUND = 0.01
# Numbers in a CSV file have eight digits.
CSV_DIGITS = 1e-7
# A drawn lens is rounded to four decimals.
FOUR_DECIMALS = 5.1e-5
# A half float has eleven bits.
FLOAT16_VALUE = 5e-4
# Disparity by a plane sweep in steps of 0.02 pixels, median.
SWEPT_DISPARITY = 0.01
# Places of a light field's cameras by matched features, units of which 20 are the way to the border: a thousandth of
# it, as features are found to a hundredth of a pixel over some ten pixels, and the same way off in all views.
CALIBRATED_PLACE = 0.02
# Views of textures of five pixels and more, 8 bit (58.9 dB alone), shifted by Lanczos with three lobes and averaged
# with rims two pixels soft, dB.
LANCZOS_OF_VIEWS_DB = 48.0
# An average of some twenty views, up to two pixels apart, against a dense aperture of the same first and second
# moments, dB: rounding of the views to 8 bits alone gives 58.9.
DISC_OF_VIEWS_DB = 48.0
# The scatter of circles of two pixels, whose rims are soft, against such an average of a plane, dB; a radius that is
# off by a fifth gives 41.
SCATTER_OF_PLANES_DB = 46.0
# The same of real views, whose depth by a sweep has errors, dB; without blur it is 30.
SCATTER_OF_REAL_VIEWS_DB = 38.0
# Share of the depths that stereo keeps on six shallow photographs of 160 x 120, and that are off by more than 5 %: what
# lies along outlines, and bars and grass with a wall behind them.
STEREO_OUTLIERS = 0.2
# A parabola's least value on a grid of steps of 1e-3: at most a quarter of the step's square above.
BEST_SCALE = 1e-6
# Correlation of two flat patches: float32 rounding of squares around zero, 1e-8, over the variances' floor of 2e-5.
FLAT_SCORE = 1e-3
# A completed surface between sightings that agree, across pixels of one colour: what leaks over a strong edge.
COMPLETED = 0.02
# The same linear systems in other units or another order, through a direct solver and 60 steps of conjugate gradients.
COMPLETED_SCALE = 1e-6
# A scale and shift that the points follow exactly, by iterated least squares; the shift's digits go with the scale's.
ALIGNED = 1e-5
# The slope of 120 points with noise of 1 % of their range.
ALIGNED_AMONG_NOISE = 0.03
# A network's map at its own size, sampled between pixels at points that lie between pixels, in float32, relative.
NETWORK_DISPARITY = 2e-3
# Radius of a circle of confusion by the second moment of a disc of a few thousand samples, relative.
LENS_RADIUS = 0.02
# Its centre, pixels, likewise.
LENS_CENTRE_PX = 0.1
# A noise's standard deviation from two halves, and from a finer render, relative: some thousand dependent pixels.
NOISE_STATED = 0.15
# The scatter against a photograph through a real lens, both of a plain room and blurred by up to 2 pixels, dB; the
# noise of 128 samples is part of it.
SCATTER_OF_A_LENS = 30.0
# The shipped photographs through a real lens. Noise of each, dB.
SHIPPED_NOISE = 40.0
# Median relative depth error of a handful of points triangulated from three small images: half a pixel over a disparity
# of nine pixels between the views.
SHIPPED_POINT_DEPTH = 0.5 / 9
# One surface in two depth maps, at the nearest pixel, relative, median: a slanted floor changes within a pixel.
SHIPPED_SURFACE = 0.01
# The scatter against them, dB, whole: bleeding at depth edges, least in `night`.
SHIPPED_SCATTER = 20.0
# In regions that blur from surfaces out of focus doesn't reach, median error of encoded values: a disc of up to a pixel
# against a soft one, and noise.
SHIPPED_SCATTER_IN_FOCUS = 0.006
# A network whose weights were rounded to eleven bits, relative to the largest output.
HALF_WEIGHTS = 5e-3
# Share of 20 000 evenly spread lens points within a circle or a quadrant of the lens.
LENS_COVERED = 0.002
# Side of a polygon's aperture against a disc's of the same area, by a numerical integral.
POLYGON_AREA = 1e-4
# A pixel's mixture of two flat colours taken apart again in float32: the share, and the colours, divided by shares.
MIXED_SHARE = 1e-4
MIXED_COLOUR = 1e-3
# Median relative difference of disparity, of a factor on one view's depth, over pixels that differ in slope.
CONSISTENCY_BIAS = 0.01
# Median residual of a fit to 120 noisy points, against the noise's own median, relative.
RESIDUAL_OF_NOISE = 0.1
# Mean light through a lens against a pinhole's: what is blurred out over the border isn't what is blurred in.
LIGHT_OF_A_LENS = 0.1
# z of the front of a shining dot at a pixel's centre, which isn't its nearest point, scene units.
DOT_DEPTH = 0.005
# p of 100 000 random choices of signs: four standard errors at p = 0.5, of both programs.
FLIPPED_AT_RANDOM = 0.009
# A sampled lens against a camera that really moves, mean over a picture of random colours: perspective takes each
# footprint's shape from where its Gaussian stands, which differs by the shift.
LENS_MOVED_CAMERA = 1e-3
# Best scale of a few lens points with Gaussian cells, one set of constants for all radii: a sixth of the 12 % by which
# a single cell of the disc's variance is off.
PATTERN_SCALE = 0.02
# What few lens points miss of a blur's effect: before a plane five miss 3 %, by their transfer function; where one
# surface hides another each of them decides over a fifth of the light.
FEW_POINTS = 0.14
# Five to 37 aperture samples with Gaussian cells against a disc, one textured plane, mean over encoded pixels.
SAMPLED_PLANE = 4e-3
# Light of a blurred background on a sharp foreground that hides it, encoded, where it should be none.
LENS_SMEAR = 5e-2
# The planes' ends beside the nearest and farthest true disparity, relative: percentiles of the points, and a margin.
SWEEP_REACH = 0.5
# A level is a whole number of steps; both are floats.
ROUNDED_LEVEL = 1e-9
# 1.96 stands for the quantile 1.95996 of the normal distribution, 2e-5 more; a bound moves by no more than its reach.
NORMAL_QUANTILE = 4e-5
# Half a unit of the last printed digit of a mean, and of each value that it is of.
PRINTED_MEAN = {
    "psnr": 0.0101,
    "ssim_uniform7": 0.00101,
    "delta_a": 0.00101,
    "delta_f": 0.00101,
    "aif_psnr": 0.0101,
    "aif_ssim_uniform7": 0.00101,
}
# The blur of an edge, as a factor: the window around the edge cuts the tails of a wide one.
EDGE_BLUR = 1.25
# Deviation in pixels by which the differences that stand for a gradient blur an edge themselves.
DIFFERENCE_BLUR = 0.6
# A noise's deviation from a median over 128 x 128 numbers: by chance 1 %, and a ramp adds to small ones.
MEASURED_NOISE = 5e-2
# Coordinates that a browser computes in double precision and that come back as decimal text.
DRAWN_PIXEL = 1e-6
# An affine map of colours fitted by normal equations in float64: squares lose half of the digits,
# float32 pictures more.
COLOUR_UNDONE = 1e-6
# A focus fitted to half of a photograph of 96 x 80 pixels by some twenty renderings: the search ends where a tenth of a
# pixel in the circles is left, of circles of 3 px.
FITTED_FOCUS = 0.02  # 1 / scene unit, of a range of 0.6
# Logarithm of a photograph's factor by medians over some 150 points that it shares, with 1 % noise and up to a fifth of
# the points wrong.
GAIN_BY_MEDIANS = 0.02
# Sums over 288 float32 numbers, by a central difference of 0.01 of a smooth function.
RESPONSE_GRADIENT = 2e-3
# A photograph's factor after 500 visits of Adam, whose rate falls to a tenth.
GAIN_LEARNED = 0.01
# Structure from motion of six views 320 pixels wide, features found to a third of a pixel: rotation from one view to
# the next in degrees (0.3 px are 0.05 degrees, and a focal length that is off turns into rotation), the ratio of
# distances between neighbours, and the focal length, which six views from one side determine least.
MOTION_ROTATION_DEG, MOTION_BASELINE, MOTION_FOCAL = 0.3, 0.05, 0.05
# Median relative error of triangulated depth: half a pixel over a disparity of tens.
TRIANGULATED_DEPTH = 0.02
# A shared lens of A and F of 0.2 and more, with the floor of 1e-5 added twice, relative: 1e-4; and float32.
LENS_FLOOR = 2e-4
# PSNR in dB of a constant error of 0.1 in float32 pictures, whose rounding of 1e-7 is 1e-5 dB.
PSNR_OF_FLOAT32 = 1e-4
# An aperture found by a shortened search, or by the median of others: exact enough to distinguish it from wrong ones.
ROUGH_APERTURE = 0.2
# How far a step moves a learned number of order 1 in float32: number and result are rounded, by at most 2^-24 each.
LEARNED_STEP = 2.0**-23
# Standard deviation of 4000 drawn numbers: its relative standard error is 1 / sqrt(2 n), and four of them.
DEVIATION_OF_4000 = 4 / (2 * 4000) ** 0.5
# The loss of a training step against the same terms in float64 of the same float32 rendering, relative: images of the
# scatter to FLOAT32_VALUE of white against differences of some tenths, and its stretched weights, slope 15, likewise.
LOSS_OF_A_STEP = 15 * FLOAT32_VALUE
# A quotient of two sums of 180 positive float32 numbers: each sum is off by more than 6 sqrt(n) 2^-24 once in 1e8.
QUOTIENT_OF_SUMS_OF_180 = 2 * 6 * 180**0.5 * 2.0**-24
# Standard errors that chance exceeds once in 16 000 times.
BY_CHANCE = 4
# A Gaussian whose alpha rounds to the other side of 1/255 is drawn by one and left out by the other: share of the
# pixels that may differ by that.
DRAWN_OR_NOT = 1e-3
# A clock that adds up tenths of a second in float64 may reach its budget a step sooner or later; steps are whole.
ONE_STEP = 1
# Share of a training's steps that a stage gets by an estimated pace, averaged over 30 of hundreds of steps.
PACED_SHARE = 2e-2
# Seconds are printed whole: rounded by up to a half, and both sides are sums of floats.
WHOLE_SECONDS = 0.5 + 1e-6
# The pace of the latest steps is taken over some of them, of which the printed time rounds half a second off hundreds.
LATEST_PACE = 0.01
# Times of up to 1e5 seconds in float64, one of whose differences may be 1e-3: 1.5e-11 over 1e-3.
DIFFERENCE_OF_TIMES = 1e-7
# EXIF's rationals: the writer of the test's photographs chooses denominators of 10 000 and more.
EXIF_RATIONAL = 1e-4
# Above 38 dB a photograph's score is what the search for its lens leaves: mean squares of two searches within a factor
# of two, dB.
TWO_FITS_DB = 3.02

# Two trainings whose numbers differ by rounding alone: Adam's first steps have their full length whatever the
# gradient's, so a gradient near zero may go either way. On average over a picture that is less than
# half of an 8-bit level.
UNSEEN = 0.5 / 255
# Places along a ray are searched among 100 001.
SEARCHED_PLACE = 1e-5
# Depths where pieces of a ray meet, relative: thousands of float64's roundings, for rays nearly along a diagonal.
SAME_DEPTH = 1e-12
# Weights so near a threshold, relative, that float32 may put them on its other side: some hundred roundings.
AT_A_THRESHOLD = 1e-3
# Second moments of a disc by some ten thousand points, one in each ring of equal area, relative and of its quarter.
SAMPLED_DISC = 0.01
# A point about 5 scene units from a camera, by float32 places and directions: some roundings of 3e-7.
FLOAT32_POINT = 1e-5
# A field's lens after 400 steps with 16 random aperture samples a pixel: at the end Adam still walks by its rate,
# 0.01, a few steps of one direction long.
LENS_FOUND_BY_RAYS = 0.05
# The mean of x^2 over a disc, between the pixels of a small picture: it has some hundred points a pixel, and a sum over
# pixels that differ in where they lie; relative, whole and at half the size, with a quarter of the pixels.
DISC_ON_PIXELS, DISC_ON_FEWER_PIXELS = 0.02, 0.04
# One pixel's mean over a disc by 400 points: the square of a place varies by its mean over the disc, in 400 strata.
DISC_OF_A_PIXEL = 0.05
# Steps: Adam near a minimum walks at its rate, and turns around once its mean of gradients, which remembers some ten
# (beta 0.9), has changed its sign.
ADAM_TURNS = 10
# Adam's first step by its rate of 1e-4, as the difference of two float32 numbers about 1, which are rounded to 6e-8.
ADAM_FIRST_STEP = 2e-3

# dB by which a method that models a blur must be better than its plain version on a scene of that blur, all in focus.
# Seeds of a plain version differ by 0.1 dB.
CLAIMED_GAIN = 0.4

# Share of stereo's scores that float32 puts on the other side of a source's border, or whose plane it decides where two
# cost the same: coordinates of 60 pixels are rounded by 4e-6, so one pixel in 1e5. A hundred pixels may have one.
STEREO_AT_A_BORDER = 0.01
# The disparity of what counts as infinitely far: more than 500 sides of a box of 4 scene units away.
AS_IF_INFINITELY_FAR = 1 / 2000
# Depth by a network that is exact up to its alignment, relative: float32 maps, and between pixels an interpolated
# depth, whose curvature over half a pixel is a ten-thousandth.
ALIGNED_DEPTH = 1e-3
