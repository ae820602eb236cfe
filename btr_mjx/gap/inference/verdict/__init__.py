"""From a finished search to a diagnosis: named effects, lack of fit, intervals, confounds, open-loop gap."""
