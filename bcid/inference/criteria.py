"""The thresholds of verdicts."""

# What chance alone does less often than this is a surprise: false alarms of tests of many numbers together (Bonferroni).
ALPHA = 0.01
# A set that could not be followed to the end is told when it is at least this probable on the frames before.
MIN_REPORTED_PROBABILITY = 0.01
# How often the forward model cannot follow the true set to the end: what a set that fails has for it before the measurement.
CONTINUATION_FAILURE_RATE = 0.01
# What is at least this probable is told as certain, and what is less as open.
CREDIBLE_LEVEL = 0.95
# What is more probable than this is likelier than all else together.
MAJORITY = 0.5
# A residual that is so many times the noise is not explained by it, where it cannot be asked whether something is missing.
MAX_NORMALISED_RMS = 2.0
# What moves the markers by less than this part of the noise (RMS) is not looked for: nothing is said of it.
MIN_EFFECT_SIZE = 0.5
# An amount is seen where its standard deviation before the data is so many times that after: what is smaller is told as nothing.
DETECTION_THRESHOLD = 3.0
# A model may be named although something is missing besides when it explains this part of what its errors leave open.
MIN_EXPLAINED_FRACTION = 0.95
