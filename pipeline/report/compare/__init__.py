"""Which runs stand beside each other in a plot, and how their curves are summarised."""
