"""The study of the map stream: how far a client's map is from the daemon's, against bytes a second.

The stream's own source, pacer and turns send the map of simulated pings over a link in simulated
time; what the daemon's map truly is at each ping is worked out by plain numpy.
"""

from studies.accuracy_cost.streaming.measuring import StreamStudy

__all__ = ["STUDY"]

STUDY = StreamStudy()
