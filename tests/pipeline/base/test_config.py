"""The configuration: every preset is valid, and every mistake is refused with what is allowed."""

from pathlib import Path
from typing import get_args

import pytest
from omegaconf.errors import OmegaConfBaseException

from mrtask.errors import InputError
from mrtask.likelihood.kinds import KINDS
from mrtask.likelihood.options import TrainingOptions
from mrtask.planning.paper.planner import PaperOptions
from mrtask.planning.planners import PLANNERS
from mrtask.planning.pouct import PouctOptions
from pipeline.base.config import CONF_DIR, UserError, content_hash, load
from pipeline.base.sections import ModelKind
from pipeline.inputs import training
from tests.pipeline.configured import composed_by_hydra, configured

CHOICES = sorted(path for path in CONF_DIR.glob("*/*.yaml") if len(list(path.parent.glob("*.yaml"))) > 1)
"""The options of groups that have several; every configuration holds the others'."""


@pytest.mark.parametrize("path", CHOICES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_option_of_every_group_is_valid(path: Path) -> None:
    needed = {
        "mixed": ["evaluation.planners=[greedy,pouct]"],
        "procthor": ["homes.files=[a.jsonl]"],
        "ros_map": ["homes.map=a.yaml", "homes.containers=b.yaml"],
    }
    configured(f"{path.parent.name}={path.stem}", *needed.get(path.stem, []))


def test_defaults_are_the_papers_experiment() -> None:
    config = configured()
    assert config.homes.train == 500
    evaluation = config.evaluation
    assert len(evaluation.size_classes) * len(evaluation.robots) * evaluation.trials_per_cell == 900
    assert set(evaluation.planners) == set(PLANNERS)
    assert config.output_dir == str(Path("outputs/paper").absolute())


@pytest.mark.parametrize(("name", "options"), [("pouct", PouctOptions()), ("pouct_paper", PaperOptions())])
def test_the_configuration_shows_every_option_of_the_searches_with_its_default(name: str, options: object) -> None:
    assert configured().planner[name] == vars(options)


def test_relative_paths_are_the_callers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    config = configured("output_dir=here", "homes=procthor", "homes.files=[a.jsonl,b.jsonl]", "datasets_dir=/data")
    assert config.output_dir == str(tmp_path / "here")
    assert config.homes.model_dump()["files"] == (tmp_path / "a.jsonl", tmp_path / "b.jsonl")
    assert config.datasets_dir == Path("/data")
    assert config.tracking.uri == f"sqlite:///{tmp_path}/outputs/mlflow.db"
    assert configured("output_dir=s3://bucket/run").output_dir == "s3://bucket/run"


def test_single_values_stand_for_lists_of_one() -> None:
    evaluation = configured("evaluation.robots=2", "evaluation.planners=greedy", "evaluation.templates=and2").evaluation
    assert (evaluation.robots, evaluation.planners, evaluation.templates) == ((2,), ("greedy",), ("and2",))


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["planner.pouct.samples=-5"], ["pouct", "samples must be at least 1, not -5"]),
        (["+planner.pouct.smaples=5"], ["pouct", "smaples", "samples"]),
        (["+planner.puct.samples=5"], ["unknown planner 'puct'", "pouct"]),
        (["evaluation.planners=[greedy,pouctt]"], ["unknown planner 'pouctt'; did you mean pouct? allowed: "]),
        (["+planner_variants.eager={planner: pouctt}"], ["planner_variants.eager: ", "did you mean pouct?"]),
        (["evaluation.size_classes=[smal]"], ["did you mean small? allowed: 'small', 'medium', 'large'"]),
        (["evaluation.model_uri=champion"], ["evaluation.model_uri=champion: allowed: models:/NAME/VERSION, "]),
        (["contents.sha256=abc"], ["contents.sha256=abc: allowed: 64 hexadecimal digits"]),
        (["+planner_variants={a b: {planner: pouct}}"], ["allowed: names of letters, digits, _, - and :"]),
        (["evaluation.planners=[pouct,foo]"], ["evaluation.planners", "'foo'", *PLANNERS]),
        (["evaluation.planners=[greedy,greedy]"], ["evaluation.planners", "once"]),
        (["evaluation.planners=[no.such.module]"], ["no.such.module", "cannot be imported"]),
        (["evaluation.size_classes=[tiny]"], ["tiny", "'small', 'medium', 'large'"]),
        (["evaluation.templates=[and9]"], ["and9", "and2", "or_seq"]),
        (["evaluation.robots=[0]"], ["evaluation.robots.0=0", "at least 1"]),
        (["evaluation.trials_per_cell=0"], ["evaluation.trials_per_cell=0", "at least 1"]),
        (["evaluation.speed_m_per_s=0"], ["evaluation.speed_m_per_s=0", "greater than 0"]),
        (["evaluation.max_failed_fraction=2"], ["at most 1"]),
        (["map=3"], ["map=3: should hold keys and values"]),
        (["homes=residence", "homes.containers=20"], ["homes.containers=20: must be at least 50"]),
        (["homes=residence", "homes.flats=1"], ["homes.flats=1: must be at least 2"]),
        (
            ["homes=residence", "homes.flats=40", "homes.flats_per_side=2"],
            ["flats_per_side = 2 makes 10 floors of 40 flats, and a residence has at most 4; choose 5 to 8"],
        ),
        (["homes=ros_map", "homes.map=3", "homes.containers=c"], ["homes.map.0=3: should be the path of a file"]),
        (["seed=null"], ["seed=None: has no value"]),
        (["evaluation.rerun=[failled]"], ["'error', 'timeout', 'failed'"]),
        (["map.resolution_m=-1"], ["map.resolution_m", "greater than 0"]),
        (["model.kind=transformer"], ["model.kind=transformer", *KINDS]),
        (["cluster.address=nowhere"], ["cluster.address=nowhere: allowed: local, auto, ray://HOST:PORT or HOST:PORT"]),
        (["homes=procthor"], ["homes.files", "a value is needed"]),
        (["homes=procthor", "homes.files=[]"], ["homes.files"]),
        (["homes=ros_map", "homes.map=a.yaml"], ["homes.containers", "a value is needed"]),
        (
            ["homes=ros_map", "homes.map=[a.yaml,b.yaml]", "homes.containers=c.yaml"],
            ["homes.map lists 2 and homes.containers 1; give one for each map"],
        ),
        (["realism.models=[best]"], ["realism.models.0=best", *KINDS]),
        (["+foo=1"], ["foo: no such key", "evaluation", "homes"]),
        (["+evaluation.robot=1"], ["evaluation.robot: no such key", "did you mean robots?"]),
        (["+homes.count=1"], ["homes.count: no such key", "train"]),
        (["seed=-1", "evaluation.robots=[0]"], ["seed=-1", "evaluation.robots.0=0"]),
        (["seed=many"], ["seed=many", "integer"]),
        (["model=frequency", "+model.layers=[3]"], ["model.layers: no such key", "smoothing"]),
        (["model.kind=oracle"], ["model.kind=oracle", "allowed: 'similarity', 'paper_fcnn'"]),
    ],
)
def test_mistakes_are_refused_with_what_is_allowed(overrides: list[str], said: list[str]) -> None:
    with pytest.raises(UserError) as caught:
        configured(*overrides)
    for part in said:
        assert part in str(caught.value)


@pytest.mark.parametrize(
    "overrides",
    [
        ["evaluation.task=Mug", "evaluation.formula=F Mug"],
        ["perception.true_positive_prob=0.1", "perception.false_positive_prob=0.2"],
        [f"evaluation.cost={'x' * 500}"],
    ],
)
def test_a_message_repeats_no_whole_section_and_no_long_value(overrides: list[str]) -> None:
    with pytest.raises(UserError) as caught:
        configured(*overrides)
    assert len(str(caught.value)) < 250 and "{" not in str(caught.value)


def test_a_variant_that_no_stage_runs_is_known() -> None:
    variant = "+planner_variants.eager={planner: pouct, options: {exploration: 0.5}}"
    assert configured(variant).idle_variants == ("eager",)
    assert configured(variant, "evaluation.planners=[pouct,eager]").idle_variants == ()
    assert configured(variant, "optimality.planners=[eager]").idle_variants == ()


def test_options_of_an_own_planner_stand_under_its_name() -> None:
    planners = "evaluation.planners=[tests.pipeline.own_planners.Gated]"
    config = configured(planners, "+planner.Gated.gate=there")
    assert config.spec("tests.pipeline.own_planners.Gated").options == {"gate": "there"}
    with pytest.raises(UserError, match=r"own_planners\.Gated.*door"):
        configured(planners, "+planner.Gated.door=there")


def test_model_kinds_and_training_options_fit_the_library() -> None:
    assert get_args(ModelKind) == tuple(KINDS)
    for kind in KINDS:
        assert configured(f"model={kind}").model.kind == kind
    config = configured("model=mlp", "seed=3", "trainer.max_epochs=7")
    options = training.options(config.training_spec)
    assert isinstance(options, TrainingOptions)
    assert (options.kind, options.network.seed, options.network.max_epochs) == ("mlp", 3, 7)


def test_content_hash_depends_on_values_not_on_order() -> None:
    assert content_hash({"a": 1, "b": [2]}) == content_hash({"b": [2], "a": 1})
    assert content_hash({"a": 1}) != content_hash({"a": 2})


def test_a_variant_has_its_planners_options_but_for_its_own() -> None:
    variant = "+planner_variants.still={planner: pouct, options: {reassign: free}}"
    config = configured(variant, "evaluation.planners=[pouct,still]", "planner.pouct.samples=7")
    assert config.spec("still").options == config.spec("pouct").options | {"reassign": "free"}
    assert (config.spec("still").planner, config.spec("pouct").planner) == ("pouct", "pouct")
    with pytest.raises(UserError, match=r"planner_variants.greedy: is a planner's own name"):
        configured("+planner_variants.greedy={planner: pouct, options: {}}")
    with pytest.raises(UserError, match=r"planner_variants.still: planner 'pouct' refuses its options.*pace"):
        configured("+planner_variants.still={planner: pouct, options: {pace: 3}}")


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("evaluation.unsearched_share=[0.8,0.5]", "give the least share first"),
        ("evaluation.unsearched_share=[0.5,1.5]", "at most 1"),
        ("evaluation.cost=energy", "allowed: 'makespan', 'least_motion'"),
        ("map.ways=scenic", "allowed: 'shortest', 'soft'"),
        ("evaluation.homes.order=random", "allowed: 'shuffled', 'file'"),
        ("planner.learned_myopic.reassign=none", "reassign must be 'all' or 'free', not 'none'"),
        ("planner.greedy.reassign=none", "reassign must be 'all' or 'free', not 'none'"),
        ("planner.learned_myopic.return_to_known=never", "return_to_known must be 'at_once' or 'when_complete'"),
    ],
)
def test_protocol_switches_say_what_they_allow(override: str, said: str) -> None:
    with pytest.raises(UserError) as caught:
        configured(override)
    assert said in str(caught.value)


def test_tests_configure_as_hydra_does() -> None:
    own = ["evaluation.planners=[tests.pipeline.own_planners.Gated]", "+planner.Gated.gate=there"]
    overrides = ["experiment=smoke", "model=mlp", "seed=3", "evaluation.robots=[1,2]", *own]
    assert configured(*overrides) == load(composed_by_hydra(overrides))
    with pytest.raises(OmegaConfBaseException):
        configured("evaluation.robot=1")


@pytest.mark.parametrize(
    ("overrides", "kind", "rivals"),
    [
        ((), "similarity", ("paper_fcnn",)),
        (("model=mlp",), "mlp", ()),
        (("model=similarity",), "similarity", ()),
        (("experiment=smoke",), "similarity", ()),
        (("experiment=paper_full",), "paper_fcnn", ()),
        (("model=mlp", "rivals=[frequency]"), "mlp", ("frequency",)),
    ],
)
def test_only_the_default_model_has_a_rival(overrides: tuple[str, ...], kind: str, rivals: tuple[str, ...]) -> None:
    config = configured(*overrides)
    assert (config.model.kind, config.rivals) == (kind, rivals)


@pytest.mark.parametrize(
    ("robots", "said"),
    [
        ("[{speed_m_per_s: 0}]", "team.robots.0.speed_m_per_s=0: must be greater than 0"),
        ("[{sped_m_per_s: 1}]", "no such key; did you mean speed_m_per_s?"),
        ("[]", "the team 'mine' has no robots"),
        ("[{name: a}, {name: a}]", "two robots are called 'a'"),
        ("[{opens: [Frige]}]", "did you mean Fridge?"),
        ("[{handles: [Mugg]}]", "did you mean Mug?"),
        ("[{handles: []}]", "can handle no object"),
        ("[{name: a}]", "evaluation.robots=[1, 2]: team 'mine' has 1 robot"),
    ],
)
def test_a_bad_team_is_refused(robots: str, said: str, tmp_path: Path) -> None:
    asked = "[1,2]" if "team 'mine' has 1" in said else "1"
    common = ("evaluation.planners=greedy", f"evaluation.robots={asked}")
    with pytest.raises(InputError) as refused:
        configured("team.name=mine", f"team.robots={robots}", *common)
    assert said in str(refused.value)
    if robots != "[]":
        file = tmp_path / "mine.yaml"
        file.write_text(f"robots: {robots}")
        with pytest.raises(InputError) as in_file:
            configured(f"team.file={file}", *common)
        assert said in str(in_file.value)


def test_the_papers_planner_refuses_robots_that_do_not_handle_all() -> None:
    with pytest.raises(UserError, match="the paper's planner does not know robots that cannot handle every object"):
        configured("team=mixed")
