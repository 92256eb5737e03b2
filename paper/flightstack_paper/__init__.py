"""`flightstack reproduce`: every figure and number of the paper, computed anew beside what the paper says."""
