"""A campaign: does another mapper or another planner gain more?

python examples/09_campaign.py [FOLDER]

`insonify campaign` does the same on all cores or on a cluster, and goes on after a kill.
"""

import sys
from pathlib import Path

from insonify import load_campaign
from insonify.mission.campaign import CampaignSettings
from insonify.mission.tables import paired
from insonify.results.campaign import run_campaign

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/examples") / "campaign"
own = str(Path(__file__).with_name("08_own_mapper.py")) + ":Despeckled"

settings = CampaignSettings(
    scenarios=["tetrapod"],
    planners=["entropy", "uniform"],
    mappers=["bayes", own],
    seeds=3,
    set={"mapping": {"voxel_m": 0.25}, "survey": {"waypoints": 12}},
)
run_campaign(settings, folder)  # what is there is not flown again

campaign = load_campaign(folder)
print(campaign.runs.groupby(["mapper", "planner"])["solid_exact_f1"].agg(["mean", "std"]))
first = campaign.curves[campaign.curves["scan"] == 1]
print(f"after one scan: F1 {first['solid_exact_f1'].mean():.3f}")
for row in paired(campaign.runs):
    one, other = (name.rpartition(":")[2] for name in row["names"])
    print(f"{one} - {other}: F1 {row['mean']:+.3f}, p {row['p_holm']:.3f} after Holm")
