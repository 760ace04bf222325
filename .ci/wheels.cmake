# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

# The wheels of ROS name header folders of the machine that built them. CMake refuses targets with missing folders, so
# remove these from every imported target.
function(remove_missing_folders)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target ${targets})
    get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
    set(existing "")
    foreach(folder ${folders})
      if(EXISTS "${folder}")
        list(APPEND existing "${folder}")
      endif()
    endforeach()
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${existing}")
  endforeach()
endfunction()
cmake_language(DEFER CALL remove_missing_folders)
