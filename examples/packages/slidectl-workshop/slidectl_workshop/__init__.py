"""Parts for slidectl: the commands `nudge` and `sim now`, and one each of gateways, sensors and steps."""
