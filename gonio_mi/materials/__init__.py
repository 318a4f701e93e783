"""What BSDF plugins share."""
