//! `plumbline manual`: man pages and shell completions, made of the command line's own description, and JSON schemas of configuration files.

use super::Cli;
use crate::cli::say::say;
use crate::config::schema::schemas;
use crate::failure::Failure;
use clap::{Args, Command, CommandFactory};
use clap_complete::{Shell, generate};
use clap_mangen::Man;
use std::path::{Path, PathBuf};

/// Options of `plumbline manual`.
#[derive(Args)]
pub struct Options {
    /// Folder, laid out as /usr/share: ~/.local/share for one user
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Shells and the files, below a folder such as /usr/share, in which they look for completions of a command.
const COMPLETIONS: [(Shell, &str); 3] = [
    (Shell::Bash, "bash-completion/completions/plumbline"),
    (Shell::Zsh, "zsh/site-functions/_plumbline"),
    (Shell::Fish, "fish/vendor_completions.d/plumbline.fish"),
];

pub fn run(options: Options) -> Result<(), Failure> {
    let mut command = Cli::command();
    command.build();
    let mut pages = 0;
    page(&command, &options.out.join("man/man1"), &mut pages)?;
    say!("{}: {pages} man pages", options.out.join("man/man1").display());
    for (shell, file) in COMPLETIONS {
        let mut script = Vec::new();
        generate(shell, &mut Cli::command(), "plumbline", &mut script);
        let path = options.out.join(file);
        crate::atomic::write_result(&path, &script)?;
        say!("{}: completions of {shell}", path.display());
    }
    for (name, schema) in schemas() {
        let path = options.out.join(format!("plumbline/schema/{name}.json"));
        let text = serde_json::to_string_pretty(&schema).map_err(Failure::job)?;
        crate::atomic::write_result(&path, format!("{text}\n").as_bytes())?;
        say!("{}: schema of {name} files", path.display());
    }
    Ok(())
}

/// The page of a command and those of its subcommands: plumbline.1, plumbline-robot.1, plumbline-robot-import.1.
fn page(command: &Command, folder: &Path, pages: &mut usize) -> Result<(), Failure> {
    let name = command.get_display_name().unwrap_or_else(|| command.get_name()).to_string();
    let mut text = Vec::new();
    let man =
        Man::new(command.clone()).title(name.to_uppercase()).source(format!("plumbline {}", env!("CARGO_PKG_VERSION")));
    man.render(&mut text).map_err(Failure::job)?;
    crate::atomic::write_result(&folder.join(format!("{name}.1")), &text)?;
    *pages += 1;
    let own = command.get_subcommands().filter(|subcommand| subcommand.get_name() != "help");
    own.into_iter().try_for_each(|subcommand| page(subcommand, folder, pages))
}
