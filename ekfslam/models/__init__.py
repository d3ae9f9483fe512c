"""Motion and sensor models: functions with their Jacobians."""
