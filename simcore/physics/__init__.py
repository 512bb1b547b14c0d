"""X-ray physics below the stages: materials and their cross sections, spectra, basis maps, specifications."""
