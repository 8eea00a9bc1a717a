"""Many flights, and what they say of estimate and integrity: consistency, accuracy, false "may dock"."""
