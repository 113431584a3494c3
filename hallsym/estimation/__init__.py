"""Finding the parameters: run statistics, likelihood, starts, optimum, outliers, the saved calibration."""
