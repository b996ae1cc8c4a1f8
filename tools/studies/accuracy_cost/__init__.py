"""What accuracy costs in time: each knob turned on fixed dives whose truth is known."""
