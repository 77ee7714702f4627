"""Parts for slidectl: the commands `nudge` and `sim now`, the gateway `udp` and the step `still`."""
