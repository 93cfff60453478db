"""Evidence about bcid: what is measured of it, and with which command. It imports bcid, never the other way round."""
