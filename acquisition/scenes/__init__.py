"""Ground truth: the analytic ray caster, motions, textures and the named scenes."""
