"""The likelihood of logs with noisy sensors, by Kalman's filter and its derivatives."""
