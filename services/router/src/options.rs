//! The command line.

pub const HELP: &str = "\
zloam-router: a Zenoh router with memory storages and REST linked in

usage: zloam-router [--config FILE] [--set KEY=VALUE]... [--check]
       zloam-router --health [ENDPOINT] [--set KEY=VALUE]...

  --config FILE       Zenoh configuration (JSON5), e.g. deploy/zenoh/router.json5
  --set KEY=VALUE     overrides one value, e.g. plugins/rest/http_port=127.0.0.1:8000; may be repeated
  --check             print the effective configuration and end
  --health [ENDPOINT] ask a running router (default tcp/127.0.0.1:7447); exit code 0: it answers.
                      --set gives what the link needs, e.g. transport/link/tls/root_ca_certificate=FILE
  --version, --help

Storages and REST run when the configuration names them under plugins/. RUST_LOG sets the log.
Exit codes: 0 ended as asked; 2 command line or configuration; 3 it could not start, as a port is
taken or a file can't be read; 1 anything else.
";

const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

#[derive(Debug, PartialEq)]
pub enum Action {
    Route,
    Check,
    Health(String),
    Help,
    Version,
}

#[derive(Debug, PartialEq)]
pub struct Options {
    pub action: Action,
    pub config: Option<String>,
    pub settings: Vec<(String, String)>,
}

pub fn parse(arguments: impl Iterator<Item = String>) -> Result<Options, String> {
    let mut options = Options { action: Action::Route, config: None, settings: vec![] };
    let mut arguments = arguments.peekable();
    while let Some(word) = arguments.next() {
        let mut value = || arguments.next().ok_or(format!("{word} needs a value"));
        match word.as_str() {
            "--config" | "-c" => options.config = Some(value()?),
            "--set" => {
                let text = value()?;
                let (key, value) =
                    text.split_once('=').ok_or(format!("--set {text}: key=value is expected"))?;
                options.settings.push((key.to_string(), value.to_string()));
            }
            "--check" => options.action = Action::Check,
            "--health" => {
                let endpoint = arguments.next_if(|next| !next.starts_with("--"));
                options.action = Action::Health(endpoint.unwrap_or(DEFAULT_ENDPOINT.to_string()));
            }
            "--help" | "-h" => options.action = Action::Help,
            "--version" => options.action = Action::Version,
            other => return Err(format!("{other} is unknown")),
        }
    }
    if options.config.is_some() && matches!(options.action, Action::Health(_)) {
        return Err("--config is not read by --health: give what the link needs by --set".into());
    }
    Ok(options)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(words: &[&str]) -> Result<Options, String> {
        parse(words.iter().map(|w| w.to_string()))
    }

    #[test]
    fn reads_what_help_promises() {
        let o = of(&["--config", "a.json5", "--set", "mode=router", "--check"]).unwrap();
        assert_eq!(o.action, Action::Check);
        assert_eq!(o.config.as_deref(), Some("a.json5"));
        assert_eq!(o.settings, [("mode".to_string(), "router".to_string())]);
        assert_eq!(of(&["--health"]).unwrap().action, Action::Health(DEFAULT_ENDPOINT.into()));
        assert_eq!(of(&["--health", "tls/h:1"]).unwrap().action, Action::Health("tls/h:1".into()));
    }

    #[test]
    fn refuses_the_rest() {
        assert!(of(&["--set", "mode"]).is_err());
        assert!(of(&["--config"]).is_err());
        assert!(of(&["--colour"]).is_err());
        assert!(of(&["--config", "a.json5", "--health"]).is_err());
        assert!(of(&["--health", "tls/h:1", "--config", "a.json5"]).is_err());
    }
}
