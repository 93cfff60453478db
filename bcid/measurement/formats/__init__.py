"""Files of motion capture, pose estimation, image correlation, robots and MATLAB: a reader for each family.

A reader is a function ``read(path, how) -> Foreign``; `bcid.measurement.formats.recognise` finds it by the content of a file. It
raises InputError where the file is cut off or damaged, its numbers are none, or the package that reads it is not installed.
"""
