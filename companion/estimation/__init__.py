"""Where the receiver is relative to the tanker: alignment to one instant, then fusion of GPS and vision."""
