"""How much accuracy each of the kernel's numerical choices gives up, and how much time it saves."""
