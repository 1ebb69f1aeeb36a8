//! Tables of other programs become the campaign of the workbench.

use std::path::{Path, PathBuf};

use analysis::import::import_campaign;
use anyhow::{Result, bail};
use axum::Json;
use axum::extract::State;
use axum::response::Response;
use model_export::output::{Overwrite, check_vacant, write_same};
use model_export::recordings::campaign::recording_folders;
use model_export::recordings::description::parse_toml;
use model_export::recordings::guess::{self, Survey};
use model_export::recordings::mapping::Mapping;
use model_export::stop::Stop;
use report::html::workbench::import::{self as form, ImportForm};
use serde::Deserialize;
use serde_json::Value;

use crate::commands::workbench::{Server, respond};

/// The campaign of the workbench.
pub struct Opened {
    pub campaign: PathBuf,
    /// The command that imports it, where the page did.
    pub import: Option<String>,
}

/// Ends of the names of tables and bags.
const SOURCES: [&str; 4] = [".csv", ".csv.gz", ".mcap", ".db3"];

/// The campaign that the paths name; `None` where they are tables.
///
/// # Errors
/// They are neither.
pub fn campaign_of(paths: &[PathBuf]) -> Result<Option<Opened>> {
    for path in paths {
        let found = recording_folders(path);
        match (&found, paths) {
            (Ok(_), [_]) => return Ok(Some(Opened { campaign: path.clone(), import: None })),
            _ if is_source(path) => {}
            (Ok(_), _) => {
                bail!("{} is a campaign: give one campaign, or tables only", path.display());
            }
            _ => drop(found?),
        }
    }
    Ok(None)
}

/// Whether an import may read this: a file, or a folder of tables or of a bag. A model file is none.
fn is_source(path: &Path) -> bool {
    let has_tables = |name: &str| SOURCES.iter().any(|end| name.to_lowercase().ends_with(end));
    let mut names = path.read_dir().into_iter().flatten().flatten().map(|entry| entry.file_name());
    names.any(|name| has_tables(&name.to_string_lossy()))
        || (path.is_file() && path.extension().is_none_or(|end| end != "toml"))
}

/// The page with the mapping that the sources propose.
pub fn page(sources: &[PathBuf], nonce: &str) -> String {
    let mapping = |survey: &Survey| {
        let proposed = survey.proposal.as_ref().ok();
        proposed
            .map(|proposal| parse_toml::<Mapping>(Path::new("mapping"), &proposal.text))
            .transpose()
    };
    let tables = guess::survey(sources).and_then(|survey| Ok((mapping(&survey)?, survey)));
    let form = ImportForm {
        sources: sources.iter().map(|source| source.display().to_string()).collect(),
        tables: tables
            .map(|(mapping, survey)| (survey, mapping))
            .map_err(|error| error.to_string()),
        outputs: vacant(sources),
    };
    form::page(&form, nonce)
}

/// Names of a new campaign and its mapping file, after the first source.
fn vacant(sources: &[PathBuf]) -> [String; 2] {
    let name = sources.first().and_then(|source| source.file_name()).unwrap_or_default();
    let name = name.to_string_lossy();
    let stem = name.split('.').next().filter(|stem| !stem.is_empty()).unwrap_or("my");
    let mut campaigns = (1..).map(|number| match number {
        1 => format!("{stem}-campaign"),
        _ => format!("{stem}-campaign-{number}"),
    });
    let outputs = |campaign: String| [format!("{campaign}.mapping.toml"), campaign];
    let is_free = |paths: &[String; 2]| paths.iter().all(|path| !Path::new(path).exists());
    let [mapping, campaign] = campaigns.by_ref().map(outputs).find(is_free).unwrap_or_default();
    [campaign, mapping]
}

/// Imports the tables of the server, once.
pub(super) async fn import(
    State(server): State<Server>,
    Json(request): Json<ImportRequest>,
) -> Response {
    respond(move || {
        let import = || {
            if let Ok(opened) = server.opened() {
                bail!("{} is imported: load this page again", opened.campaign.display());
            }
            let (answer, opened) = request.import(&server.sources)?;
            if let Some(opened) = opened {
                let _ = server.campaign.set(opened);
            }
            Ok(answer)
        };
        server.computing.run(&Stop::default(), import)
    })
    .await
}

/// The content of a mapping file, and what to write.
#[derive(Deserialize)]
pub struct ImportRequest {
    text: String,
    mapping: PathBuf,
    campaign: PathBuf,
}

impl ImportRequest {
    /// Writes the mapping and the campaign; returns the campaign too if it can be fitted. A failed import leaves neither.
    pub fn import(&self, sources: &[PathBuf]) -> Result<(Value, Option<Opened>)> {
        let Self { text, mapping, campaign } = self;
        if campaign.as_os_str().is_empty() || mapping.as_os_str().is_empty() {
            bail!("an output has no name: name the new folder and the new mapping file");
        }
        check_vacant(campaign)?;
        let is_new = !mapping.exists();
        write_same(mapping, text.as_bytes(), Overwrite::NEVER)?;
        let imported = import_campaign(mapping, sources, campaign).inspect_err(|_| {
            if is_new {
                let _ = std::fs::remove_file(mapping);
            }
        })?;
        let words = [mapping].into_iter().chain(sources).map(|path| path.display().to_string());
        let words = words.chain(["-o".to_owned(), campaign.display().to_string()]);
        let line = format!("cargo magpie import {}", shell_words::join(words));
        let opened = Opened { campaign: campaign.clone(), import: Some(line) };
        let answer = form::imported(&imported, &vacant(sources));
        Ok((answer, (!imported.is_refused()).then_some(opened)))
    }
}
