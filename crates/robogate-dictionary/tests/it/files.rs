//! Files that survive a power failure.

use std::fs;

use robogate_dictionary::files::{create_folders, write, write_new};

use crate::common::Folder;

#[test]
fn links_stay_and_their_files_are_replaced() {
    let folder = Folder::new("files");
    let at = |name: &str| folder.join(name);
    create_folders(at("a/b")).unwrap();
    write(at("a/b/file"), "one").unwrap();
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(at("a/b/file"), at("link")).unwrap();
        write(at("link"), "two").unwrap();
        assert!(at("link").is_symlink());
        assert_eq!(fs::read_to_string(at("a/b/file")).unwrap(), "two");
        write("/dev/null", "three").unwrap();
    }
    let error = write_new(&at("a/b/file"), "four").unwrap_err();
    assert_eq!(error.kind(), std::io::ErrorKind::AlreadyExists);
    // Nothing is left of a file that cannot be written.
    fs::create_dir(at("a/b/folder")).unwrap();
    assert!(write(at("a/b/folder"), "").is_err());
    assert_eq!(fs::read_dir(at("a/b")).unwrap().count(), 2);
    assert!(write(at("missing/file"), "").is_err());
    assert!(create_folders(at("a/b/file")).is_err());
}
