"""A recording's signals: spectra, noise, prepared records, faults of samples."""
