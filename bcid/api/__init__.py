"""What `import bcid` gives: functions that take a scene and a measurement, and the results that they return."""
