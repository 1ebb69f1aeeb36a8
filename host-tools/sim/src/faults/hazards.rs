//! Hazard table: what is required in each state and under each fault ([`TEXT`]), independent of the firmware's own tables.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::sync::LazyLock;

use anyhow::{Context, Result, ensure};
use firmware::grip::fault_reactions::Reaction;
use firmware::grip::states::{GripPhase, PowerState, TaskState};
use firmware::system::faults::Fault;
use serde::Deserialize;

/// The table of the gripper.
pub const TEXT: &str = include_str!("../../../../firmware/hazards.toml");

static TABLE: LazyLock<HazardTable> = LazyLock::new(|| match HazardTable::parse(TEXT) {
    Ok(table) => table,
    Err(error) => panic!("firmware/hazards.toml: {error:#}"),
});

/// A hazard table.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HazardTable {
    source: Vec<Source>,
    hazard: Vec<Hazard>,
    state: Vec<StateRow>,
    fault: Vec<FaultRow>,
    #[serde(skip)]
    bounds: Bounds,
}

/// The figures of the hazards.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bounds {
    /// "crushing": maximum force on a hand outside of a grip, in N.
    pub hand_n: f64,
    /// "trapping": minimum travel of an opening in mm, and its time in s.
    pub opens: (f64, f64),
    /// "dropping": minimum remaining share of the grip force.
    pub kept_share: f64,
    /// "collapse": maximum motion of the fingers in foot mode, in mm.
    pub foot_mm: f64,
    /// "wrong force": maximum force of a grip of 100 N after a fault of one sensor, in N.
    pub grip_n: f64,
}

/// Standard or document that a requirement follows.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// Name.
    pub id: String,
    /// What it says.
    pub text: String,
}

/// A hazard, and the bounds that it sets.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hazard {
    /// Name.
    pub id: String,
    /// Harm.
    pub harm: String,
    /// Requirement.
    pub required: String,
    /// Maximum force in newtons.
    pub max_n: Option<f64>,
    /// Minimum travel of an opening in millimetres.
    pub opens_mm: Option<f64>,
    /// Maximum time of an opening in seconds.
    pub within_s: Option<f64>,
    /// Minimum remaining share of a grip force.
    pub min_share: Option<f64>,
    /// Maximum motion of the fingers in millimetres.
    pub moves_mm: Option<f64>,
}

/// What RELEASE does in a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Release {
    /// The fingers open.
    Opens,
    /// It is refused; [`StateRow::free`] tells what helps.
    Refused,
}

/// Requirements in a state.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StateRow {
    /// Name of the state.
    pub name: String,
    /// Hazards in this state.
    pub hazards: Vec<String>,
    /// Effect of RELEASE.
    pub release: Release,
    /// How a person gets free.
    pub free: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
enum RequiredReaction {
    #[serde(rename = "report")]
    Report,
    #[serde(rename = "hold")]
    Hold,
    #[serde(rename = "quick stop")]
    QuickStop,
    #[serde(rename = "brake")]
    Brake,
    #[serde(rename = "off")]
    Off,
}

impl RequiredReaction {
    const fn reaction(self) -> Reaction {
        match self {
            Self::Report => Reaction::Warn,
            Self::Hold => Reaction::Hold,
            Self::QuickStop => Reaction::QuickStop,
            Self::Brake => Reaction::Brake,
            Self::Off => Reaction::Off,
        }
    }
}

/// Required reactions to a fault.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FaultRow {
    name: String,
    hazards: Vec<String>,
    moving: RequiredReaction,
    self_locking: RequiredReaction,
    backdrivable: RequiredReaction,
    releasing: RequiredReaction,
    foot: RequiredReaction,
    why: String,
}

impl HazardTable {
    /// The table of the gripper.
    ///
    /// # Panics
    /// The file is invalid, which a test excludes.
    pub fn gripper() -> &'static Self {
        &TABLE
    }

    /// Parses a table.
    ///
    /// # Errors
    /// Wrong syntax, with line and column; an unknown hazard, or one without its figure; a state or fault that is unknown,
    /// missing or listed twice.
    pub fn parse(text: &str) -> Result<Self> {
        let mut table: Self = toml::from_str(text)?;
        table.bounds = table.read_bounds()?;
        let faults = Fault::ALL.map(|fault| format!("{fault:?}"));
        let states = PowerState::ALL.iter().filter(|state| **state != PowerState::Enabled);
        let states = states.map(|state| format!("{state:?}"));
        let tasks = TaskState::ALL.iter().map(|state| format!("{state:?}"));
        let states: Vec<String> = states.chain(tasks).collect();
        let names = table.state.iter().map(|row| row.name.as_str());
        check_names("state", names, &states)?;
        let names = table.fault.iter().map(|row| row.name.as_str());
        check_names("fault", names, &faults)?;
        let rows = table.state.iter().map(|row| (&row.name, &row.hazards));
        for (name, hazards) in rows.chain(table.fault.iter().map(|row| (&row.name, &row.hazards))) {
            ensure!(!hazards.is_empty(), "{name} has no hazard");
            for id in hazards {
                table.hazard(id).with_context(|| format!("in {name}"))?;
            }
        }
        Ok(table)
    }

    fn read_bounds(&self) -> Result<Bounds> {
        let figure = |id: &str, name: &str, of: fn(&Hazard) -> Option<f64>| {
            of(self.hazard(id)?).with_context(|| format!("hazard \"{id}\" has no {name}"))
        };
        Ok(Bounds {
            hand_n: figure("crushing", "max_n", |hazard| hazard.max_n)?,
            opens: (
                figure("trapping", "opens_mm", |hazard| hazard.opens_mm)?,
                figure("trapping", "within_s", |hazard| hazard.within_s)?,
            ),
            kept_share: figure("dropping", "min_share", |hazard| hazard.min_share)?,
            foot_mm: figure("collapse", "moves_mm", |hazard| hazard.moves_mm)?,
            grip_n: figure("wrong force", "max_n", |hazard| hazard.max_n)?,
        })
    }

    fn hazard(&self, id: &str) -> Result<&Hazard> {
        let mut hazards = self.hazard.iter();
        hazards.find(|hazard| hazard.id == id).with_context(|| format!("no hazard \"{id}\""))
    }

    /// The figures of the hazards.
    pub const fn bounds(&self) -> &Bounds {
        &self.bounds
    }

    /// States with their requirements.
    pub fn states(&self) -> &[StateRow] {
        &self.state
    }

    /// Required reaction to a fault; none where the table does not list the fault.
    pub fn reaction(&self, fault: Fault, phase: GripPhase, self_locking: bool) -> Option<Reaction> {
        let name = format!("{fault:?}");
        let row = self.fault.iter().find(|row| row.name == name)?;
        let required = match (phase, self_locking) {
            (GripPhase::Moving, _) => row.moving,
            (GripPhase::Holding, true) => row.self_locking,
            (GripPhase::Holding, false) => row.backdrivable,
            (GripPhase::Releasing, _) => row.releasing,
            (GripPhase::Foot, _) => row.foot,
        };
        Some(required.reaction())
    }

    /// The table as Markdown.
    pub fn markdown(&self) -> String {
        let mut text = String::from("| hazard | harm | requirement |\n| --- | --- | --- |\n");
        for Hazard { id, harm, required, .. } in &self.hazard {
            let _ = writeln!(text, "| {id} | {harm} | {required} |");
        }
        text.push_str(
            "\n| state | meaning | hazards | RELEASE | how a person gets free |\n| --- | --- | --- | --- | --- |\n",
        );
        let powers = PowerState::ALL.iter().map(|state| (format!("{state:?}"), state.meaning()));
        let tasks = TaskState::ALL.iter().map(|state| (format!("{state:?}"), state.meaning()));
        let meanings: HashMap<String, &str> = powers.chain(tasks).collect();

        for StateRow { name, hazards, release, free } in &self.state {
            let release = if *release == Release::Opens { "opens" } else { "refused" };
            let _ = writeln!(
                text,
                "| {} | {} | {} | {release} | {free} |",
                spaced(name),
                meanings.get(name).map_or("", |meaning| phrase(meaning)),
                hazards.join(", ")
            );
        }
        text.push_str(
            "\n| fault | meaning | nothing gripped | held, self-locking | held, backdrivable | opening | foot | reason |\n\
             | --- | --- | --- | --- | --- | --- | --- | --- |\n",
        );
        let meanings: HashMap<String, &str> =
            Fault::ALL.map(|fault| (format!("{fault:?}"), fault.meaning())).into();

        for row in &self.fault {
            let columns = [row.moving, row.self_locking, row.backdrivable, row.releasing, row.foot];
            let columns = columns.map(|required| spaced(&format!("{required:?}")));
            let meaning = meanings.get(&row.name).map_or("", |meaning| phrase(meaning));
            // Source and detail of the event are for programmers.
            let meaning = meaning.split(" Source:").next().unwrap_or(meaning);
            let meaning = meaning.split(" Detail:").next().unwrap_or(meaning);
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} |",
                spaced(&row.name),
                phrase(meaning),
                columns.join(" | "),
                row.why
            );
        }
        text.push('\n');
        for Source { id, text: says } in &self.source {
            let _ = writeln!(text, "* {id}: {says}.");
        }
        text
    }
}

/// A sentence as an entry of a table.
fn phrase(sentence: &str) -> &str {
    sentence.trim().trim_end_matches('.')
}

/// "QuickStop" as "quick stop".
fn spaced(name: &str) -> String {
    let mut words = String::new();
    for (index, letter) in name.char_indices() {
        if letter.is_uppercase() && index > 0 {
            words.push(' ');
        }
        words.extend(letter.to_lowercase());
    }
    words
}

fn check_names<'t>(
    kind: &str,
    names: impl Iterator<Item = &'t str> + Clone,
    required: &[String],
) -> Result<()> {
    for name in names.clone() {
        ensure!(required.iter().any(|known| known == name), "unknown {kind} \"{name}\"");
    }
    for known in required {
        let count = names.clone().filter(|name| name == known).count();
        ensure!(count == 1, "{kind} {known} is listed {count} times instead of once");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware::grip::fault_reactions::reaction;
    use firmware::grip::transitions::{TASK_TRANSITIONS, TaskEvent};

    const PHASES: [GripPhase; 4] =
        [GripPhase::Moving, GripPhase::Holding, GripPhase::Releasing, GripPhase::Foot];

    #[test]
    fn reactions_of_the_firmware_are_those_required() {
        for fault in Fault::ALL {
            for (phase, locks) in
                PHASES.into_iter().flat_map(|phase| [(phase, true), (phase, false)])
            {
                let required = HazardTable::gripper().reaction(fault, phase, locks);
                assert_eq!(
                    Some(reaction(fault, phase, locks)),
                    required,
                    "{fault:?} {phase:?} {locks}"
                );
            }
        }
    }

    #[test]
    fn release_is_accepted_in_the_states_that_require_it() {
        for state in TaskState::ALL {
            let accepts = TASK_TRANSITIONS.iter().any(|(from, event, to)| {
                (from, event, to) == (state, &TaskEvent::Release, &TaskState::Releasing)
            });
            let name = format!("{state:?}");
            let row = HazardTable::gripper().states().iter().find(|row| row.name == name);
            let required = row.map(|row| row.release);
            assert_eq!(
                required,
                Some(if accepts { Release::Opens } else { Release::Refused }),
                "{name}"
            );
        }
    }

    #[test]
    fn every_hazard_occurs_and_errors_name_their_place() {
        let table = HazardTable::gripper();
        for Hazard { id, .. } in &table.hazard {
            let of_faults = table.fault.iter().flat_map(|row| &row.hazards);
            let mut used = table.state.iter().flat_map(|row| &row.hazards).chain(of_faults);
            assert!(used.any(|used| used == id), "{id}");
        }
        for (from, to, message) in [
            ("name = \"Hot\"", "name = \"Cold\"", "unknown fault \"Cold\""),
            ("name = \"Hot\"", "name = \"Blind\"", "fault Blind is listed 2 times"),
            ("moving = \"brake\"", "moving = \"pray\"", "line"),
            ("hazards = [\"collapse\"]", "hazards = [\"rain\"]", "no hazard \"rain\""),
            ("moves_mm = 0.1", "", "hazard \"collapse\" has no moves_mm"),
        ] {
            let error = HazardTable::parse(&TEXT.replacen(from, to, 1)).unwrap_err();
            assert!(format!("{error:#}").contains(message), "{error:#}");
        }
    }

    /// `UPDATE_README=1 cargo test -p sim hazards` rewrites the tables.
    #[test]
    fn safety_page_shows_the_table() {
        const BEGIN: &str = "<!-- hazards -->\n";
        const END: &str = "<!-- end of hazards -->\n";
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../firmware/SAFETY.md");
        let page = std::fs::read_to_string(path).unwrap();
        let (before, rest) = page.split_once(BEGIN).unwrap();
        let (shown, after) = rest.split_once(END).unwrap();
        let expected = HazardTable::gripper().markdown();
        if std::env::var_os("UPDATE_README").is_some() {
            std::fs::write(path, format!("{before}{BEGIN}{expected}{END}{after}")).unwrap();
            return;
        }
        assert_eq!(shown, expected, "run this test with UPDATE_README=1");
    }
}
