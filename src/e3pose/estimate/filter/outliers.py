"""Limits of outliers: the same for every use of residuals."""

# tuned: standard deviations | simulated: 1.5, 2, 2.5 give 21.4, 21.2, 21.7 mm | wild keypoints
OUTLIER_SIGMAS = 2.0  # where the weight of a residual is halved
ROBUST = 1 / OUTLIER_SIGMAS**2  # definition
# tuned: standard deviations | not recorded | measured
MEASURED_SIGMAS = 3.0  # a joint counts as measured if a keypoint was this near
# tuned: keypoints | chosen for shifts of cameras, which are no longer learned | noise with a memory
MEMORY = 15_000.0  # keypoints of a camera: some minutes of two people who are seen all the time
LEAST_KNOWN = 50.0  # definition: keypoints from which on what a camera taught is worth telling
